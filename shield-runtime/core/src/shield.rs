//! The shield: decides before every action whether it could be undone.
//!
//! Allow, else project, else abort. Whatever goes wrong on the way to a verdict aborts: a number that is not finite, a wrong length, a
//! plugin or solver that fails, a missed deadline. [`Ladder`] decides and does nothing else; what follows a decision is the
//! [reset cycle](crate::cycle)'s.

mod clock;
mod explanation;
mod jury;
mod ladder;
mod moment;
mod projection;
mod qp;
mod rejected;
mod rows;
mod rules;
mod setup;
pub mod solver;

pub use jury::Judgement;
pub use ladder::{Ladder, LadderSettings, write_safe};
pub use moment::{Agents, GivenValues, Moment};
pub use rules::RuleTree;
pub use setup::{LadderParts, nearest_to_zero};
