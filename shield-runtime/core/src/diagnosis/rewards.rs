//! Whether aborting pays: an agent whose steps cost more than an abort learns to be aborted.

use serde::{Deserialize, Serialize};

use super::{Diagnosis, Finding};

/// Rewards that are looked at together: several episodes of most environments.
const REWARDS: u32 = 500;

/// The present group of rewards.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct Rewards {
    count: u32,
    below: u32,
    sum: f64,
}

impl Rewards {
    /// A forward step was rewarded. Returns whether in the group that it completes most steps were worth less than an abort.
    pub fn note(&mut self, reward: f64, abort_reward: f64) -> Option<(bool, Finding)> {
        self.count += 1;
        self.below += u32::from(reward < abort_reward);
        self.sum += reward;
        if self.count < REWARDS {
            return None;
        }
        let Self { count: rewards, below, sum } = std::mem::take(self);
        let mean = sum / f64::from(rewards);
        Some((2 * below > rewards, Finding::AbortsPay { below, rewards, mean, abort_reward }))
    }
}

impl Diagnosis {
    /// A forward step was rewarded; an abort gives the other reward.
    pub(crate) fn reward(&mut self, reward: f64, abort_reward: f64) {
        if let Some((holds, finding)) = self.rewards.note(reward, abort_reward) {
            self.note(holds, finding);
        }
    }
}
