//! Gridworlds with absorbing cells.
