//! A reset task for any environment: reset is being near a start.
