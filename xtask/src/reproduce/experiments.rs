//! Which files there are, in the order in which they are run: what takes least comes first.

/// One experiment.
#[derive(Debug)]
pub struct Experiment {
    /// Name of the file, and of the experiment in it.
    pub name: &'static str,
    /// Where the file is.
    pub folder: &'static str,
    /// What it is about.
    pub title: &'static str,
    /// Its plots, by the names that `shield report` gives them.
    pub figures: &'static [&'static str],
}

impl Experiment {
    /// Its file, from the root.
    pub fn file(&self) -> String {
        format!("{}/{}.ron", self.folder, self.name)
    }
}

const fn paper(name: &'static str, title: &'static str, figures: &'static [&'static str]) -> Experiment {
    Experiment { name, folder: "examples/paper", title, figures }
}

/// Without plots: its table says everything.
const fn untouched(name: &'static str, title: &'static str) -> Experiment {
    Experiment { name, folder: "examples/untouched", title, figures: &[] }
}

const ROBOT: &[&str] = &["return", "hard-resets", "final-hard-resets", "final-return"];

/// The paper's.
pub const PAPER: &[Experiment] = &[
    paper(
        "gridworld-aborts",
        "Gridworld: where aborts happen (figures 2 and 3)",
        &["where-south-east", "where-two-goals"],
    ),
    paper("gridworld-qmin", "Gridworld: Q_min (figure 4)", &["final-hard-resets", "steps-to-solve"]),
    paper(
        "gridworld-combine",
        "Gridworld: combining the ensemble (appendix A)",
        &["final-hard-resets", "final-return"],
    ),
    paper("ball-in-cup-small", "Ball in cup (section 6.1)", &["return", "hard-resets", "lifetime-reward"]),
    paper("pusher-small", "Pusher (sections 6.2 to 6.5, appendix A)", ROBOT),
    paper("cliff-cheetah-small", "Cliff cheetah (sections 6.2 to 6.4, appendix A)", ROBOT),
    paper("peg-insertion-small", "Peg insertion (section 6.6)", &["return", "success", "hard-resets"]),
    paper("cliff-walker-small", "Cliff walker (appendix A)", ROBOT),
    paper(
        "cart-small",
        "Cart: a stand-in for sections 6.3 to 6.5",
        &["final-hard-resets", "final-irreversible-entries", "final-return"],
    ),
];

/// The cart of the quickstart: its targets are its own.
pub const CART: &str = "quickstart";
/// Not rows of the table of environments, but tables of their own: what each part of the shield contributes, and what another accepted risk changes.
pub const STUDIES: [&str; 3] = ["ablation", "risk", "risk-cheetah"];

/// Those of the shield as it is, without a setting for an environment.
pub const UNTOUCHED: &[Experiment] = &[
    untouched("gridworld-south-east", "gridworld, south-east"),
    untouched("gridworld-two-goals", "gridworld, two goals"),
    Experiment { folder: "examples", ..untouched(CART, "cart") },
    untouched("pusher", "pusher"),
    untouched("cheetah-14", "cheetah, 14 m"),
    untouched("cheetah-3", "cheetah, 3 m"),
    untouched("walker", "walker"),
    untouched("ablation", "Ablation"),
    untouched("risk", "The accepted risk, on the cart"),
    untouched("risk-cheetah", "The accepted risk, on the cheetah"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_experiment_is_named_once_and_as_its_file() {
        let mut names = Vec::new();
        for experiment in PAPER.iter().chain(UNTOUCHED) {
            let path = crate::cargo::workspace_root().join(experiment.file());
            let text = std::fs::read_to_string(path).unwrap();
            assert!(text.contains(&format!("\n    name: \"{}\",\n", experiment.name)), "{}", experiment.name);
            assert!(!names.contains(&experiment.name), "{}", experiment.name);
            names.push(experiment.name);
        }
    }
}
