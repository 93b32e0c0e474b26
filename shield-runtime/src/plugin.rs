//! Loading plugins.
