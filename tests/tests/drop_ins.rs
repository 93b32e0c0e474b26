//! Undo probabilities with the real plugins in a loop of one's own: what is kept of them, and files of version 1.0.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{fs, path::Path, sync::OnceLock};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{Environment, Phase, Setup};
use shield_runtime::{
    cycle::HardResetDue,
    decision::Decision,
    drop_in::DropIn,
    drop_in_files,
    experiment::DropInFile,
    plugin::{Registry, SearchPath, Selection, host},
    world::{Stepped, World},
};
use shield_tests::plugins_folder;

const UNDOING: &str = r#"rules: [(plugin: "undo-probability", config: (relative: false, initial_threshold: 0.9))],
    success_critic: (plugin: "success-critic"), shield_exploration: true,"#;

fn registry() -> &'static Registry {
    static REGISTRY: OnceLock<Registry> = OnceLock::new();
    REGISTRY.get_or_init(|| Registry::scan(&SearchPath::new([plugins_folder()])))
}

/// A cart, a shield with a memory that forgets, and a policy that acts at random.
struct Cart {
    shield: DropIn,
    world: World,
    policy: Pcg64,
}

/// What was decided in a step, who was in charge then, and what was executed.
type Trace = Vec<(Decision, Phase, f32)>;

impl Cart {
    fn new(shield: &str, capacity: usize) -> Self {
        let environment =
            registry().environment(&Selection::new("mujoco/cliff-cart"), "", &Setup::new(0, 1, host()));
        let environment = environment.unwrap();
        let spaces = environment.spec().spaces;
        let text = format!(
            r#"DropIn(
                reset: (plugin: "ddpg", config: (critics: 2, actor_hidden: [16], critic_hidden: [16])),
                shield: ({shield} warm_up_steps: 0),
                experience: (batch: 16, updates: Both, capacity: {capacity}, bootstrap_probability: 0.7),
                episode_length: 40,
            )"#
        );
        let file = DropInFile::from_text("x.ron", text.as_str(), &[]).unwrap();
        let shield = file.open(registry(), Some(spaces)).unwrap();
        let mut cart = Self {
            shield,
            world: World::new(Box::new(environment), None).unwrap(),
            policy: Pcg64::seed_from_u64(0),
        };
        cart.place(0);
        cart
    }

    /// A hard reset, after which the policy begins anew.
    fn place(&mut self, seed: u64) {
        self.shield.require_hard_reset(HardResetDue::Lost);
        self.policy = Pcg64::seed_from_u64(seed);
        self.world.hard_reset(None, seed).unwrap();
        self.shield.hard_reset_done(self.world.observation()).unwrap();
    }

    fn drive(&mut self, steps: u64) -> Trace {
        let mut trace = Trace::new();
        for step in 0..steps {
            let phase = self.shield.phase();
            let mut action = [self.policy.random_range(-1.0..=1.0)];
            let decision = self.shield.filter(self.world.observation(), &mut action).unwrap();
            trace.push((decision, phase, action[0]));
            let Stepped::Made(outcome) = self.world.step(&action).unwrap() else {
                panic!("it is not isolated")
            };
            self.shield.observe_outcome(self.world.next_observation(), &outcome).unwrap();
            self.world.advance();
            if self.shield.needs_hard_reset() {
                self.world.hard_reset(None, step).unwrap();
                self.shield.hard_reset_done(self.world.observation()).unwrap();
            }
        }
        trace
    }

    fn metric(&self, wanted: &str) -> f64 {
        let mut found = f64::NAN;
        self.shield.metrics(&mut |name, value| {
            if name == wanted {
                found = value;
            }
        });
        found
    }
}

/// What a shield does after it was kept and after it was loaded: the same.
fn go_on_alike(saved: &mut Cart, mut loaded: Cart, file: &Path) {
    drop_in_files::load(&mut loaded.shield, file).unwrap();
    assert!(loaded.shield.needs_hard_reset());
    let [expected, found] = [saved, &mut loaded].map(|cart| {
        cart.place(9);
        cart.drive(400)
    });
    let kinds = |phase: Phase| expected.iter().filter(|step| step.1 == phase).count();
    let kinds = [Phase::Forward, Phase::Reset].map(kinds);
    assert!(kinds.iter().all(|count| *count > 20), "{kinds:?}");
    let first =
        expected.iter().zip(&found).position(|(one, other)| format!("{one:?}") != format!("{other:?}"));
    assert_eq!(first, None, "{:?} and {:?}", expected[first.unwrap_or(0)], found[first.unwrap_or(0)]);
}

#[test]
fn a_drop_in_with_a_success_critic_goes_on_where_it_was_kept() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    for capacity in [200, 5_000] {
        let mut saved = Cart::new(UNDOING, capacity);
        saved.drive(1_000);
        assert!(saved.metric("reset_episodes") > 3.0 && saved.metric("success/success_loss").is_finite());
        drop_in_files::save(&mut saved.shield, &file).unwrap();
        go_on_alike(&mut saved, Cart::new(UNDOING, capacity), &file);
    }
    // One without what it had learned does something else.
    let mut fresh = Cart::new(UNDOING, 200);
    fresh.place(9);
    let mut loaded = Cart::new(UNDOING, 200);
    drop_in_files::load(&mut loaded.shield, &file).unwrap();
    loaded.place(9);
    assert_ne!(format!("{:?}", fresh.drive(100)), format!("{:?}", loaded.drive(100)));
}

#[test]
fn a_drop_in_goes_on_in_more_and_in_less_room() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let mut saved = Cart::new(UNDOING, 300);
    saved.drive(1_000);
    drop_in_files::save(&mut saved.shield, &file).unwrap();
    for capacity in [299, 301, 5_000, 40] {
        let mut loaded = Cart::new(UNDOING, capacity);
        drop_in_files::load(&mut loaded.shield, &file).unwrap();
        loaded.place(0);
        loaded.drive(300);
        assert!(loaded.metric("success/success_loss").is_finite(), "room for {capacity}");
    }
}

/// The file as version 1.0 wrote it, whose state ended before what belongs to undo probabilities: the shortest that is still a state.
fn as_in_1_0(file: &Path, rules: &str) {
    let whole = fs::read(file).unwrap();
    let write = |left_out: usize| {
        let mut bytes = whole[..whole.len() - left_out].to_vec();
        let (length, checksum) = ((bytes.len() - 24) as u64, crc32fast::hash(&bytes[24..]));
        bytes[12..20].copy_from_slice(&length.to_le_bytes());
        bytes[20..24].copy_from_slice(&checksum.to_le_bytes());
        fs::write(file, bytes).unwrap();
    };
    let is_state = |left_out: &usize| {
        write(*left_out);
        drop_in_files::load(&mut Cart::new(rules, 500).shield, file).is_ok()
    };
    let newer = (1..whole.len()).take_while(is_state).last().expect("something follows");
    write(newer);
}

#[test]
fn a_file_of_version_1_0_is_gone_on_from() {
    let rules = r#"rules: [(plugin: "ensemble-threshold", config: (q_min: 8.0, combine: Realist))],"#;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let mut saved = Cart::new(rules, 500);
    saved.drive(1_000);
    saved.place(1);
    drop_in_files::save(&mut saved.shield, &file).unwrap();
    as_in_1_0(&file, rules);
    go_on_alike(&mut saved, Cart::new(rules, 500), &file);
    // It has nothing for a success critic.
    let error = drop_in_files::load(&mut Cart::new(UNDOING, 500).shield, &file).unwrap_err().to_string();
    assert!(error.contains("this shield has a success critic, and it has none"), "{error}");
}
