//! A trained shield around another environment.

use shield_api::ResetSignal;
use shield_runtime::drop_in::DropIn;

use super::*;

fn walks_home() -> Scripted {
    Scripted::acting(|_, _| -1.0)
}

fn trained() -> DropIn {
    let mut drop_in = builder(walks_home())
        .reset_task(Box::new(Starts(vec![0.0])))
        .learning(learning(Updates::Both, Endings::default()))
        .warm_up_steps(2)
        .build()
        .unwrap();
    drop_in.hard_reset_done(&[0.0]).unwrap();
    let mut cell = 0.0;
    for _ in 0..4 {
        let mut action = [0.5];
        drop_in.filter(&[cell], &mut action).unwrap();
        cell += action[0];
        drop_in.observe(&[cell], None, false).unwrap();
    }
    drop_in
}

fn kept(drop_in: &mut DropIn, folder: &Path) -> Vec<u8> {
    let path = folder.join("state");
    drop_in_files::save(drop_in, &path).unwrap();
    fs::read(path).unwrap()
}

#[test]
fn another_environment_is_shielded_as_the_trained_one_and_changes_nothing_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut drop_in = trained();
    let before = kept(&mut drop_in, folder.path());
    let mut other = drop_in.freeze();
    assert!(drop_in.frozen(&mut other, |view| !view.is_placed() && !view.needs_hard_reset()));
    drop_in.frozen(&mut other, |view| view.hard_reset_done(&[7.0])).unwrap();
    let mut cell = 7.0;
    for _ in 0..3 {
        let mut action = [0.5];
        let decision = drop_in.frozen(&mut other, |view| view.filter(&[cell], &mut action)).unwrap();
        assert_eq!(decision, Decision::Allow, "the warm-up was over there");
        cell += action[0];
        drop_in.frozen(&mut other, |view| view.observe(&[cell], None, false)).unwrap();
    }
    let mut action = [0.75];
    let decision = drop_in.frozen(&mut other, |view| view.filter(&[cell], &mut action)).unwrap();
    assert!(decision.abort().is_some() && action == [-1.0], "the reset agent takes over");
    assert_eq!(drop_in.phase(), Phase::Forward, "elsewhere nobody resets");
    for _ in 0..EPISODE {
        cell += action[0];
        drop_in.frozen(&mut other, |view| view.observe(&[cell], None, false)).unwrap();
        drop_in.frozen(&mut other, |view| view.filter(&[cell], &mut action)).unwrap();
    }
    assert!(drop_in.frozen(&mut other, |view| view.needs_hard_reset()), "it never came to a start");
    assert!(!drop_in.needs_hard_reset());
    assert!(kept(&mut drop_in, folder.path()) == before, "something was learned, told or counted");
}

#[test]
fn an_end_of_the_environment_earns_nothing_whatever_it_shows() {
    let agent = Scripted::acting(|_, _| 0.0);
    let mut drop_in = builder(agent).build().unwrap();
    drop_in.filter(&[3.0], &mut [0.5]).unwrap();
    drop_in.observe(&[3.0], signal(3.0), false).unwrap();
    assert!(drop_in.begin_reset());
    drop_in.filter(&[3.0], &mut [0.0]).unwrap();
    // The environment has ended, and already shows its next start.
    let start = ResetSignal { reward: 1.0, in_reset_set: true };
    drop_in.observe(&[0.0], Some(start), true).unwrap();
    assert_eq!(metric(&drop_in, "reset_successes"), 0.0);
    assert!(drop_in.needs_hard_reset());
}

#[test]
fn aborts_that_pay_are_found() {
    let mut drop_in = builder(walks_home()).build().unwrap();
    let names = |drop_in: &DropIn| drop_in.findings().map(|finding| finding.name()).collect::<Vec<_>>();
    (0..500).for_each(|_| drop_in.note_reward(-1.0, -20.0));
    assert_eq!(names(&drop_in), [""; 0]);
    (0..500).for_each(|_| drop_in.note_reward(-1.0, 0.0));
    assert_eq!(names(&drop_in), ["aborts-pay"]);
}
