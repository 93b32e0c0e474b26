//! Several worlds that step at the same time, on as many threads as are allowed.

use rayon::{
    ThreadPool, ThreadPoolBuilder,
    iter::{IndexedParallelIterator, IntoParallelRefMutIterator, ParallelIterator},
};
use shield_api::{Error, Result, StepOutcome};

use shield_core::world::{Stepped, World};

/// One world of a batch.
pub struct Lane {
    /// The world; its owner places it and looks at it between steps.
    pub world: World,
    /// What the next [`Lanes::step`] executes.
    pub action: Vec<f32>,
    /// Whether the next step steps this lane at all.
    pub is_running: bool,
    /// What its last step led to.
    outcome: Result<Stepped>,
}

impl Lane {
    fn step(&mut self) {
        if self.is_running {
            self.outcome = self.world.step(&self.action);
        }
    }

    /// What the last step led to.
    ///
    /// # Errors
    /// The action was none, or the environment failed.
    pub fn outcome(&self) -> Result<Stepped> {
        self.outcome.clone()
    }
}

/// Worlds with nothing in common. What becomes of each does not depend on how many threads there are.
pub struct Lanes {
    lanes: Vec<Lane>,
    pool: Option<ThreadPool>,
    /// So many neighbours go to one thread.
    share: usize,
}

impl Lanes {
    /// Puts worlds beside each other.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub fn new(worlds: Vec<World>, threads: usize) -> Result<Self> {
        let threads = threads.min(worlds.len());
        let share = worlds.len().div_ceil(threads.max(1)).max(1);
        let pool =
            if threads < 2 {
                None
            } else {
                let built = ThreadPoolBuilder::new().num_threads(threads).build();
                Some(built.map_err(|error| {
                    Error::failed(format!("{threads} threads cannot be started: {error}"))
                })?)
            };
        let lanes = worlds.into_iter().map(|world| Lane {
            action: vec![0.0; world.spec().spaces.action_len()],
            world,
            is_running: false,
            outcome: Ok(Stepped::Made(StepOutcome::default())),
        });
        Ok(Self { lanes: lanes.collect(), pool, share })
    }

    /// The worlds, in the order in which they were given.
    pub fn lanes(&mut self) -> &mut [Lane] {
        &mut self.lanes
    }

    /// Executes the action of every lane that is running. Each lane's outcome says what came of it.
    pub fn step(&mut self) {
        match &self.pool {
            None => self.lanes.iter_mut().for_each(Lane::step),
            Some(pool) => {
                let (lanes, share) = (&mut self.lanes, self.share);
                pool.install(|| lanes.par_iter_mut().with_min_len(share).for_each(Lane::step));
            }
        }
    }
}
