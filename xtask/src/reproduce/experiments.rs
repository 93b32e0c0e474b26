//! Which files there are, in the order in which they are run: what takes least comes first.

/// One file in examples/paper.
#[derive(Debug)]
pub struct Experiment {
    /// Name of the file, and of the experiment in it.
    pub name: &'static str,
    /// What it is about.
    pub title: &'static str,
    /// Its plots, by the names that `shield report` gives them.
    pub figures: &'static [&'static str],
}

const ROBOT: &[&str] = &["return", "hard-resets", "final-hard-resets", "final-return"];

/// What `cargo xtask reproduce` knows.
pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "gridworld-aborts",
        title: "Gridworld: where aborts happen (figures 2 and 3)",
        figures: &["where-south-east", "where-two-goals"],
    },
    Experiment {
        name: "gridworld-qmin",
        title: "Gridworld: Q_min (figure 4)",
        figures: &["final-hard-resets", "steps-to-solve"],
    },
    Experiment {
        name: "gridworld-combine",
        title: "Gridworld: combining the ensemble (appendix A)",
        figures: &["final-hard-resets", "final-return"],
    },
    Experiment {
        name: "ball-in-cup-small",
        title: "Ball in cup (section 6.1)",
        figures: &["return", "hard-resets", "lifetime-reward"],
    },
    Experiment { name: "pusher-small", title: "Pusher (sections 6.2 to 6.5, appendix A)", figures: ROBOT },
    Experiment {
        name: "cliff-cheetah-small",
        title: "Cliff cheetah (sections 6.2 to 6.4, appendix A)",
        figures: ROBOT,
    },
    Experiment {
        name: "peg-insertion-small",
        title: "Peg insertion (section 6.6)",
        figures: &["return", "success", "hard-resets"],
    },
    Experiment { name: "cliff-walker-small", title: "Cliff walker (appendix A)", figures: ROBOT },
    Experiment {
        name: "cart-small",
        title: "Cart: a stand-in for sections 6.3 to 6.5",
        figures: &["final-hard-resets", "final-irreversible-entries", "final-return"],
    },
];
