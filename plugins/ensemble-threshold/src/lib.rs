//! The paper's abort rule: the reset ensemble against Q_min.
