//! Starts that the reset task is shown before the first step, so that it can tell how far they scatter.

use shield_api::{Error, Result, check_finite};

use super::DropIn;

impl DropIn {
    /// Asks the caller to show the reset task this many further starts before the first step.
    ///
    /// # Errors
    /// There is no reset task.
    pub fn with_calibration_resets(self, calibration_resets: u32) -> Result<Self> {
        if calibration_resets > 0 && self.task.is_none() {
            return Err(Error::invalid_argument(
                "there is no reset task that calibration resets would teach",
            ));
        }
        Ok(Self { calibration_resets, ..self })
    }

    /// How many more starts are to be shown to the reset task, by [`observe_start`](Self::observe_start), before the first step. The environment
    /// must be reset for each; where that costs a person's time, none need be.
    pub fn calibration_resets(&self) -> u32 {
        if self.is_placed() || self.is_frozen { 0 } else { self.calibration_resets }
    }

    /// Shows the reset task one more start, from which nothing follows: nothing is counted, and where the environment stands stays as it was.
    /// A simulator may be reset a few times at the beginning, so that the task knows how far the starts scatter.
    ///
    /// # Errors
    /// The observation is invalid, or the reset task failed.
    pub fn observe_start(&mut self, observation: &[f32]) -> Result<()> {
        check_finite("the observation after a reset", observation, self.spaces().observation_len())?;
        if self.is_frozen {
            return Ok(());
        }
        self.calibration_resets = self.calibration_resets.saturating_sub(1);
        // What the task says of this start is not said of the first one.
        self.task.as_mut().map_or(Ok(()), |task| task.observe_start(observation))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use shield_api::{
        AbortRule, ActMode, Batch, Checkpoint, Learner, LearnerInfo, Needs, Reason, ResetSignal, ResetTask,
        RuleContext, RuleVerdict, Space, Spaces,
    };

    use super::*;

    /// Stays where it is, allows everything, and takes for a start what lies between those that it saw.
    #[derive(Default)]
    struct Everything(Vec<f32>);

    impl Checkpoint for Everything {}

    impl Learner for Everything {
        fn info(&self) -> LearnerInfo {
            LearnerInfo { members: 1, discount: 0.9 }
        }
        fn act(&mut self, _: &[f32], _: ActMode, action: &mut [f32]) -> Result<()> {
            action.fill(0.0);
            Ok(())
        }
        fn q_values(&mut self, _: &[f32], _: &[f32], values: &mut [f32]) -> Result<()> {
            values.fill(1.0);
            Ok(())
        }
        fn update(&mut self, _: &Batch<'_>) -> Result<()> {
            Ok(())
        }
    }

    impl AbortRule for Everything {
        fn needs(&self) -> Needs {
            Needs::default()
        }
        fn evaluate(&self, _: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
            Ok(RuleVerdict::from_safe(true, 1.0))
        }
    }

    impl ResetTask for Everything {
        fn observe_start(&mut self, observation: &[f32]) -> Result<()> {
            self.0.push(observation[0]);
            Ok(())
        }
        fn evaluate(&mut self, _: &[f32], _: &[f32], next: &[f32]) -> Result<ResetSignal> {
            let in_reset_set =
                self.0.iter().any(|start| *start <= next[0]) && self.0.iter().any(|start| next[0] <= *start);
            Ok(ResetSignal { reward: f32::from(u8::from(in_reset_set)), in_reset_set })
        }
    }

    fn builder() -> super::super::DropInBuilder {
        let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
        DropIn::builder(spaces, Box::new(Everything::default())).rule(Box::new(Everything::default()))
    }

    #[test]
    fn the_task_learns_from_starts_that_nobody_counts() {
        let mut drop_in =
            builder().reset_task(Box::new(Everything::default())).calibration_resets(2).build().unwrap();
        for left in [1, 0] {
            drop_in.observe_start(&[left as f32]).unwrap();
            assert_eq!((drop_in.calibration_resets(), drop_in.is_placed()), (left, false));
        }
        assert!(drop_in.observe_start(&[f32::NAN]).is_err());
        drop_in.hard_reset_done(&[5.0]).unwrap();
        drop_in.filter(&[5.0], &mut [0.0]).unwrap();
        drop_in.observe(&[3.0], None, false).unwrap();
        assert!(drop_in.begin_reset());
        drop_in.filter(&[3.0], &mut [0.0]).unwrap();
        drop_in.observe(&[3.0], None, false).unwrap();
        assert_eq!(
            (drop_in.cycle.reset_successes(), drop_in.counters().hard_resets),
            (1, 0),
            "3 lies between 0 and 5"
        );
    }

    #[test]
    fn who_begins_without_them_is_asked_no_more() {
        let mut drop_in =
            builder().reset_task(Box::new(Everything::default())).calibration_resets(20).build().unwrap();
        drop_in.hard_reset_done(&[0.0]).unwrap();
        assert_eq!(drop_in.calibration_resets(), 0);
    }

    #[test]
    fn without_a_task_they_are_refused() {
        assert!(builder().calibration_resets(1).build().err().unwrap().to_string().contains("no reset task"));
    }
}
