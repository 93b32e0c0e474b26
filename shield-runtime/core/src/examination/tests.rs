use super::*;

/// A walk away from 0, which is the start and the reset set (|x| ≤ 1).
fn drift(steps: usize, speed: f32) -> Vec<f32> {
    (1..=steps).map(|step| step as f32 * speed).collect()
}

/// Twenty starts and five walks, each with its end.
fn examined(starts: &[f32], walk: &[f32], end: StepEnd) -> Examination {
    let is_inside = |x: f32| Some(x.abs() <= 1.0);
    let mut examination = Examination::new();
    starts.iter().for_each(|start| examination.start(&[*start], is_inside(*start)));
    for _ in 0..5 {
        examination.walk();
        for (index, x) in walk.iter().enumerate() {
            let end = if index + 1 == walk.len() { end } else { StepEnd::Continues };
            examination.step(&[*x], is_inside(*x), end);
        }
    }
    examination
}

fn standing(checkup: &Checkup, name: &str) -> (Standing, String) {
    let check = checkup.checks.iter().find(|check| check.name == name).unwrap();
    (check.standing, check.seen.clone())
}

fn near_start() -> Vec<f32> {
    (0..20).map(|index| index as f32 * 0.01).collect()
}

#[test]
fn an_environment_that_is_left_and_has_a_start_is_no_obstacle() {
    let there_and_back: Vec<f32> = (1..=40).map(|step| 0.2 * (step.min(40 - step) as f32)).collect();
    let checkup = examined(&near_start(), &there_and_back, StepEnd::Continues).conclude();
    assert_eq!(checkup.verdict(), Verdict::Works, "{checkup}");
    assert!(checkup.checks.iter().all(|check| check.standing == Standing::Good), "{checkup}");
    let (_, seen) = standing(&checkup, "leaving");
    assert!(seen.contains("5 of 5 walks, after 6 steps"), "{seen}");
    assert!(checkup.to_string().ends_with("nothing is in the way of a shield"));
}

#[test]
fn a_reset_set_to_which_chance_does_not_lead_back_is_noted() {
    let checkup = examined(&near_start(), &drift(40, 0.2), StepEnd::Continues).conclude();
    assert_eq!((standing(&checkup, "leaving").0, checkup.verdict()), (Standing::Note, Verdict::Works));
}

#[test]
fn starts_outside_the_reset_set_ask_for_another_one() {
    let far: Vec<f32> = (0..20).map(|index| 5.0 + index as f32).collect();
    let checkup = examined(&far, &drift(40, 0.2), StepEnd::Continues).conclude();
    assert!(matches!(checkup.verdict(), Verdict::Change(remedy) if remedy.contains("Widen")));
    assert_eq!(standing(&checkup, "starts").0, Standing::Change);
}

#[test]
fn a_set_with_every_state_in_it_is_too_wide_or_cannot_be_helped() {
    let narrow = examined(&near_start(), &drift(40, 0.02), StepEnd::Continues).conclude();
    assert!(matches!(narrow.verdict(), Verdict::Change(remedy) if remedy.contains("Narrow")));
    assert_eq!(standing(&narrow, "leaving").0, Standing::Note);
    let everywhere: Vec<f32> = (0..20).map(|index| index as f32 * 0.05).collect();
    let hopeless = examined(&everywhere, &drift(40, 0.02), StepEnd::Continues).conclude();
    assert!(matches!(hopeless.verdict(), Verdict::CannotHelp(reason) if reason.contains("everywhere")));
}

#[test]
fn an_end_by_itself_is_told_apart_from_a_clock() {
    let clock = examined(&near_start(), &drift(40, 0.2), StepEnd::Truncated).conclude();
    assert!(matches!(clock.verdict(), Verdict::Change(remedy) if remedy.contains("episode_length")));
    let late = examined(&near_start(), &drift(40, 0.2), StepEnd::Terminated).conclude();
    assert_eq!((standing(&late, "termination").0, late.verdict()), (Standing::Note, Verdict::Works));
    let (_, seen) = standing(&late, "termination");
    assert!(seen.contains("5 of 5 walks, after 40"), "{seen}");
    let soon = examined(&near_start(), &drift(3, 2.0), StepEnd::Terminated).conclude();
    assert_eq!(standing(&soon, "termination").0, Standing::Change);
}

#[test]
fn observations_that_are_constant_or_not_finite_are_told() {
    let mut constant = Examination::new();
    constant.start(&[0.0, 7.0], Some(true));
    constant.walk();
    constant.step(&[2.0, 7.0], Some(false), StepEnd::Continues);
    let check = constant.observations();
    assert_eq!(check.standing, Standing::Note);
    assert!(check.remedy.contains("dimensions 1 "), "{}", check.remedy);
    constant.step(&[f32::NAN, 7.0], Some(false), StepEnd::Continues);
    assert!(matches!(constant.conclude().verdict(), Verdict::Change(remedy) if remedy.contains("finite")));
}

#[test]
fn what_nobody_knows_is_said_to_be_unknown() {
    let mut examination = Examination::new();
    (0..20).for_each(|_| examination.start(&[0.0], None));
    examination.walk();
    examination.step(&[0.5], Some(true), StepEnd::Continues);
    let (standing, seen) = standing(&examination.conclude(), "starts");
    assert_eq!(standing, Standing::Unknown);
    assert!(seen.contains("one step later 100%"), "{seen}");
}
