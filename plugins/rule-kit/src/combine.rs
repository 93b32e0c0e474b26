//! How the figures of an ensemble's members become one, and the rows that keep it above a threshold.

use serde::Deserialize;
use shield_api::{Error, Result, Rows, RuleContext, check_finite};

use crate::{Row, mean, require_values};

/// How the members' figures become one (paper, §4.3).
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub enum Combine {
    /// The largest: abort only if every member wants to.
    Optimistic,
    /// The mean.
    Realist,
    /// The smallest: abort if any member wants to.
    Pessimistic,
    /// The figure below which this share of the other members lies, rounded down to a member's: 0 is pessimistic, 1 optimistic.
    Quantile(f32),
    /// The k-th largest: so many members must agree to execute.
    KOfN(usize),
}

impl Combine {
    /// Refuses a quantile outside [0, 1], and 0 of n, in the setting of this name.
    ///
    /// # Errors
    /// It is such.
    pub fn check(self, name: &str) -> Result<()> {
        let message = match self {
            Self::Quantile(share) if !(0.0..=1.0).contains(&share) => {
                format!("the quantile is {share}, but must lie in [0, 1]")
            }
            Self::KOfN(0) => "0 of n members agree always; k must be at least 1".into(),
            _ => return Ok(()),
        };
        Err(Error::invalid_config(message).in_field(name))
    }

    /// How many members must reach the threshold; `None` where their mean must.
    fn quorum(self, members: usize) -> Result<Option<usize>> {
        Ok(match self {
            Self::Optimistic => Some(1),
            Self::Realist => None,
            Self::Pessimistic => Some(members),
            Self::Quantile(share) => {
                let below = f64::from(share) * (members - 1) as f64;
                Some(members - below.floor() as usize)
            }
            Self::KOfN(k) if k <= members => Some(k),
            Self::KOfN(k) => {
                let message = format!("{k} of {members} members cannot agree: k is larger than the ensemble");
                return Err(Error::invalid_argument(message));
            }
        })
    }

    /// One figure out of all of them. A member that is NaN or infinite says nothing about the action, so that nothing can be
    /// said of the ensemble either: NaN.
    ///
    /// # Errors
    /// There are no figures, or fewer than must agree.
    pub fn value(self, figures: &[f32]) -> Result<f32> {
        require_values(figures)?;
        let quorum = self.quorum(figures.len())?;
        if figures.iter().any(|figure| !figure.is_finite()) {
            return Ok(f32::NAN);
        }
        Ok(match quorum {
            None => mean(figures.iter().copied()) as f32,
            Some(quorum) => {
                let member = (0..figures.len()).find(|member| rank(figures, *member) == quorum);
                member.map_or(f32::NAN, |member| figures[member])
            }
        })
    }

    /// For a reason: which of the members' figures it is.
    pub fn words(self) -> &'static str {
        match self {
            Self::Optimistic => "largest",
            Self::Realist => "mean",
            Self::Pessimistic => "smallest",
            Self::Quantile(_) => "quantile",
            Self::KOfN(_) => "k-th largest",
        }
    }

    /// Rows under which `figures`, whose gradients these are, reach `threshold`: one for each of the members that must, which are those
    /// of the largest figures; or one for the mean.
    ///
    /// # Errors
    /// A figure or a gradient is not finite, or some are missing; a row is refused.
    pub fn push_rows(
        self,
        context: &RuleContext<'_>,
        figures: &[f32],
        gradients: &[f32],
        threshold: f32,
        row: &Row,
        rows: &mut dyn Rows,
    ) -> Result<()> {
        let (proposed, width, members) = (context.proposed, context.proposed.len(), figures.len());
        let value = self.value(figures)?;
        check_finite("values", figures, members)?;
        check_finite("gradients", gradients, members * width)?;
        let Some(quorum) = self.quorum(members)? else {
            let slopes = (0..width).map(|dimension| {
                mean((0..members).map(|member| gradients[member * width + dimension])) as f32
            });
            return row.push_at_least(proposed, value, slopes, threshold, rows);
        };
        for member in (0..members).filter(|member| rank(figures, *member) <= quorum) {
            let slopes = gradients[member * width..(member + 1) * width].iter().copied();
            row.push_at_least(proposed, figures[member], slopes, threshold, rows)?;
        }
        Ok(())
    }
}

/// The rank of a member from 1, the largest; of equal ones the earlier ranks first. Counts instead of sorting, which would allocate.
fn rank(figures: &[f32], member: usize) -> usize {
    let own = figures[member];
    let is_before = |(other, figure): &(usize, &f32)| **figure > own || **figure == own && *other < member;
    1 + figures.iter().enumerate().filter(is_before).count()
}
