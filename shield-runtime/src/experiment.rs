//! Experiments: RON files, their variants, and where in them a fault lies.

mod config;

pub use config::{
    BetweenAttempts, Endings, EvaluatedAgent, EvaluationConfig, ExperienceConfig, Experiment, Forward, Mode,
    OnResetFailure, OnResetSuccess, PluginChoice, ResetAttempts, ResetTest, ShieldConfig, Updates,
};
