//! The paper's robots in MuJoCo.
