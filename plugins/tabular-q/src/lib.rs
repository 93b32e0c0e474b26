//! Tabular Q-learning with an ensemble.
