//! The checks of an examination.

use super::{Check, Examination, Seen, Standing, Walk};

/// Where each start lies inside with probability 0.95, fewer than this share of 20 do in one case of 300.
const STARTS_INSIDE: f64 = 0.8;
/// The share of random states inside from which there is nothing to undo.
const NEARLY_ALL: f64 = 0.99;
/// A walk that terminates within so many steps leaves no time to turn back.
const AT_ONCE: f64 = 5.0;
/// Starts that spread at least this much of what random actions reach, in every dimension, are everywhere.
const EVERYWHERE: f64 = 0.7;

const RESET_SET: &str = "`reset_task` (\"calibrated-start\" needs no settings; \"near-start\" has `radius`), or in Python `in_reset_set`";

impl Examination {
    fn states(&self) -> impl Iterator<Item = &Seen> + Clone {
        self.walks.iter().flat_map(|walk| &walk.states)
    }

    pub(super) fn observations(&self) -> Check {
        let name = "observations";
        if self.not_finite > 0 {
            let seen = format!("{} observations hold NaN or infinity", self.not_finite);
            return Check::new(
                name,
                Standing::Change,
                seen,
                "let the environment give finite observations only",
            );
        }
        let rows: Vec<&[f32]> =
            self.starts.iter().chain(self.states()).map(|seen| seen.observation.as_slice()).collect();
        let Some(first) = rows.first() else {
            return Check::new(name, Standing::Unknown, "nothing was observed".into(), "");
        };
        let is_constant = |dimension: &usize| rows.iter().all(|row| row[*dimension] == first[*dimension]);
        let constant: Vec<String> =
            (0..first.len()).filter(is_constant).map(|dimension| dimension.to_string()).collect();
        let seen = format!("{} observations of {} numbers, all finite", rows.len(), first.len());
        if constant.is_empty() {
            return Check::new(name, Standing::Good, seen, "");
        }
        let seen = format!("{seen}; {} of them never change", constant.len());
        let remedy =
            format!("dimensions {} tell nothing; leave them out if that is no accident", constant.join(", "));
        Check::new(name, Standing::Note, seen, &remedy)
    }

    /// Do the starts count as reset?
    pub(super) fn starts_check(&self) -> Check {
        let name = "starts";
        let count = self.starts.len();
        let direct = share(self.starts.iter());
        // A start is always near itself: what a task says of those left out counts more.
        let Some(inside) = self.starts_inside.or(direct) else {
            let after = share(self.walks.iter().filter_map(|walk| walk.states.first()));
            let seen = format!(
                "nobody says whether a start counts as reset; one step later {} of the states do",
                after.map_or("none".into(), percent)
            );
            return Check::new(name, Standing::Unknown, seen, "");
        };
        let seen = format!("{} of {count} starts count as reset", percent(inside));
        if inside >= STARTS_INSIDE {
            return Check::new(name, Standing::Good, seen, "");
        }
        let remedy =
            format!("an attempt fails even where it comes back to a start. Widen the reset set: {RESET_SET}");
        Check::new(name, Standing::Change, seen, &remedy)
    }

    /// How much of what random actions reach counts as reset?
    pub(super) fn states_check(&self) -> Check {
        let name = "reset set";
        let Some(inside) = share(self.states()) else {
            return Check::new(name, Standing::Unknown, "nothing says what counts as reset".into(), "");
        };
        let seen = format!("{} of {} random states count as reset", percent(inside), self.states().count());
        if inside < NEARLY_ALL {
            return Check::new(name, Standing::Good, seen, "");
        }
        if self.least_spread().is_some_and(|(ratio, _)| ratio >= EVERYWHERE) {
            let remedy = "starts lie everywhere, so that there is nothing to undo. No shield is needed";
            return Check::new(name, Standing::Hopeless, seen, remedy);
        }
        let remedy = format!(
            "nothing would have to be undone. Narrow the reset set: {RESET_SET}; if the task stays that near to its start, no shield is needed"
        );
        Check::new(name, Standing::Change, seen, &remedy)
    }

    /// Do random actions leave the reset set, and do they come back?
    pub(super) fn leaving(&self) -> Check {
        let name = "leaving";
        let known: Vec<&Walk> = self
            .walks
            .iter()
            .filter(|walk| walk.states.iter().all(|seen| seen.is_inside.is_some()))
            .collect();
        if known.is_empty() {
            return Check::new(name, Standing::Unknown, "no walk was made in which that is known".into(), "");
        }
        let outside = |seen: &Seen| seen.is_inside == Some(false);
        let mut left: Vec<usize> =
            known.iter().filter_map(|walk| walk.states.iter().position(outside)).map(|at| at + 1).collect();
        left.sort_unstable();
        let Some(median) = left.get(left.len() / 2) else {
            let seen = format!("random actions never left the reset set in {} walks", known.len());
            let remedy = "only an agent that goes farther has anything to undo; look again with more `steps`";
            return Check::new(name, Standing::Note, seen, remedy);
        };
        let comes_back = |walk: &&&Walk| {
            walk.states.iter().skip_while(|seen| !outside(seen)).any(|seen| seen.is_inside == Some(true))
        };
        let returned = known.iter().filter(comes_back).count();
        let seen = format!(
            "random actions left the reset set in {} of {} walks, after {median} steps (median), and came back in {returned}",
            left.len(),
            known.len(),
        );
        if returned > 0 {
            return Check::new(name, Standing::Good, seen, "");
        }
        let remedy = "the reset agent has to learn a way back that chance does not show: give it time, or one that needs not learn";
        Check::new(name, Standing::Note, seen, remedy)
    }

    /// How far do starts spread, against random states?
    pub(super) fn spread(&self) -> Check {
        let name = "spread";
        let Some((least, most)) = self.least_spread() else {
            return Check::new(
                name,
                Standing::Unknown,
                "too little varies to compare starts with states".into(),
                "",
            );
        };
        let seen = format!(
            "starts spread {} to {} as far as random states, by dimension",
            percent(least),
            percent(most)
        );
        if least < EVERYWHERE {
            return Check::new(name, Standing::Good, seen, "");
        }
        let remedy =
            "starts lie wherever random actions lead: there is little to undo, and a shield can gain little";
        Check::new(name, Standing::Note, seen, remedy)
    }

    /// The least and the largest ratio of the spread of starts to that of random states, over the dimensions that vary within walks.
    fn least_spread(&self) -> Option<(f64, f64)> {
        let dimensions = self.starts.first()?.observation.len();
        let mut ends: Option<(f64, f64)> = None;
        for dimension in 0..dimensions {
            let column = |seen: &Seen| f64::from(seen.observation[dimension]);
            let of_states = deviation(self.states().map(column));
            let moves = self
                .walks
                .iter()
                .any(|walk| walk.states.iter().any(|seen| column(seen) != column(&walk.states[0])));
            if !moves || of_states == 0.0 {
                continue;
            }
            let ratio = deviation(self.starts.iter().map(column)) / of_states;
            let (least, most) = ends.unwrap_or((ratio, ratio));
            ends = Some((least.min(ratio), most.max(ratio)));
        }
        ends
    }

    /// Does the environment terminate by itself, and how soon?
    pub(super) fn termination(&self) -> Check {
        let name = "termination";
        let ended: Vec<usize> =
            self.walks.iter().filter(|walk| walk.has_terminated).map(|walk| walk.states.len()).collect();
        let walks = self.walks.len();
        if ended.is_empty() {
            let steps = self.states().count();
            let seen = format!("the environment did not terminate in {steps} random steps");
            return Check::new(name, Standing::Good, seen, "");
        }
        let mean = ended.iter().sum::<usize>() as f64 / ended.len() as f64;
        let seen = format!(
            "the environment terminated in {} of {walks} walks, after {mean:.0} random steps on average",
            ended.len()
        );
        let advice = "each costs a hard reset until the shield has learned to take over before. If the environment could go on, do not let it \
                      terminate (in Gymnasium often `terminate_when_unhealthy=False`)";
        if mean > AT_ONCE || 2 * ended.len() < walks {
            return Check::new(name, Standing::Note, seen, advice);
        }
        let remedy = "it ends before anything could be undone. Do not let the environment terminate where it could go on (in Gymnasium \
                      often `terminate_when_unhealthy=False`)";
        Check::new(name, Standing::Change, seen, remedy)
    }

    /// Does the environment end its episodes by a clock of its own?
    pub(super) fn truncation(&self) -> Check {
        let name = "clock";
        let ended: Vec<usize> =
            self.walks.iter().filter(|walk| walk.has_truncated).map(|walk| walk.states.len()).collect();
        let Some(first) = ended.iter().min() else {
            let longest = self.walks.iter().map(|walk| walk.states.len()).max().unwrap_or(0);
            let seen = format!("the environment ended no episode by a clock within {longest} steps");
            return Check::new(name, Standing::Good, seen, "");
        };
        let seen = format!(
            "the environment truncated {} of {} walks by itself, after {first} steps at least",
            ended.len(),
            self.walks.len()
        );
        let remedy = "no reset agent can go on from there, so that each episode costs a hard reset. Take the clock out of the environment and set \
                      `episode_length` (a `TimeLimit` of Gymnasium is taken out for you)";
        Check::new(name, Standing::Change, seen, remedy)
    }
}

/// The share of what is known that counts as reset; `None` where nothing is known.
fn share<'a>(seen: impl Iterator<Item = &'a Seen>) -> Option<f64> {
    let (mut known, mut inside) = (0_u32, 0_u32);
    for is_inside in seen.filter_map(|seen| seen.is_inside) {
        known += 1;
        inside += u32::from(is_inside);
    }
    (known > 0).then(|| f64::from(inside) / f64::from(known))
}

fn percent(share: f64) -> String {
    format!("{:.0}%", 100.0 * share)
}

fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean) * (value - mean)).sum::<f64>() / count).sqrt()
}
