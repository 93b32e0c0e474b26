//! DDPG with an ensemble of critics.
