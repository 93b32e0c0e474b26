use shield_api::{Checkpoint, Environment, ErrorKind, Host, Plugin, PluginConfig, Setup, StepOutcome};

use crate::{Gridworld, GridworldConfig};

const WEST: f32 = 0.0;
const SOUTH: f32 = 1.0;
const EAST: f32 = 2.0;
const NORTH: f32 = 3.0;

fn gridworld(config: &str) -> Gridworld {
    let config = GridworldConfig::parse(config).unwrap();
    Gridworld::create(config, &Setup::new(0, 1, Host::silent())).unwrap()
}

fn observe(world: &Gridworld) -> Vec<f32> {
    let mut observation = vec![f32::NAN; world.map.cells.len()];
    world.write_observation(&mut observation);
    observation
}

/// Follows `actions` from the start and returns the last outcome.
fn walk(world: &mut Gridworld, actions: &[f32]) -> StepOutcome {
    let mut observation = observe(world);
    world.reset(0, &mut observation).unwrap();
    let mut last = StepOutcome::default();
    for action in actions {
        last = world.step(&[*action], &mut observation).unwrap();
        assert_eq!(observation.iter().sum::<f32>(), 1.0);
        assert_eq!(observation[world.cell], 1.0);
    }
    last
}

#[test]
fn an_absorbing_cell_keeps_the_agent_until_a_hard_reset() {
    let mut world = gridworld("()");
    let fallen = walk(&mut world, &[EAST, SOUTH]);
    assert!(fallen.irreversible && !fallen.terminated && !fallen.in_reset_set);
    assert_eq!((fallen.forward_reward, fallen.reset_reward), (0.0, 0.0));
    let mut observation = observe(&world);
    for action in [WEST, SOUTH, EAST, NORTH] {
        let outcome = world.step(&[action], &mut observation).unwrap();
        assert_eq!(outcome, fallen);
    }
    world.reset(0, &mut observation).unwrap();
    assert_eq!(observation[0], 1.0);
}

#[test]
fn the_goal_rewards_each_step_and_can_be_left() {
    let mut world = gridworld(r#"(map: ["SG."])"#);
    let at_goal = walk(&mut world, &[EAST]);
    assert!(at_goal.success && !at_goal.irreversible && !at_goal.terminated);
    assert_eq!(at_goal.forward_reward, 1.0);
    let back = walk(&mut world, &[EAST, WEST]);
    assert!(back.in_reset_set && !back.success);
    assert_eq!((back.forward_reward, back.reset_reward), (0.0, 1.0));
}

#[test]
fn an_absorbing_goal_succeeds_but_cannot_be_left() {
    let mut world = gridworld(r#"(map: "two-goals")"#);
    let outcome = walk(&mut world, &[NORTH, NORTH, EAST, EAST, WEST]);
    assert!(outcome.success && outcome.irreversible);
    let outcome = walk(&mut world, &[NORTH, NORTH, WEST, WEST, WEST]);
    assert!(outcome.success && !outcome.irreversible);
}

#[test]
fn an_invalid_action_is_refused_and_changes_nothing() {
    let mut world = gridworld("()");
    walk(&mut world, &[EAST]);
    let before = world.cell;
    let mut observation = observe(&world);
    for bad in [&[][..], &[4.0], &[0.5], &[-1.0], &[f32::NAN], &[f32::INFINITY], &[1.0, 1.0]] {
        let error = world.step(bad, &mut observation).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{bad:?}");
        assert_eq!(world.cell, before);
    }
    assert!(world.step(&[1.0], &mut [0.0; 3]).is_err());
    assert_eq!(world.cell, before);
}

#[test]
fn the_horizon_comes_from_the_map_unless_configured() {
    for (config, expected) in [
        ("()", 30),
        (r#"(map: "frozen-lake-4x4")"#, 30),
        (r#"(map: "frozen-lake-8x8")"#, 100),
        (r#"(map: "frozen-lake-8x8", horizon: Some(7))"#, 7),
    ] {
        assert_eq!(gridworld(config).spec().episode_length, expected, "{config}");
    }
    let config = GridworldConfig::parse("(horizon: Some(0))").unwrap();
    let refused = Gridworld::create(config, &Setup::new(0, 1, Host::silent()));
    assert_eq!(refused.err().unwrap().kind(), ErrorKind::InvalidConfig);
}

#[test]
fn a_wrong_configuration_is_refused_with_its_fault_and_place() {
    for (config, expected) in [
        ("(map: \"nowhere\")", "frozen-lake-4x4"),
        ("(\n  map: [\"S?G\"])", "'?'"),
        ("(mapp: \"two-goals\")", "mapp"),
        ("(map: 3)", "list of its rows"),
    ] {
        let error = GridworldConfig::parse(config).unwrap_err();
        assert!(error.to_string().contains(expected), "{config}: {error}");
        assert!(error.position().is_some(), "{config}");
    }
}

#[test]
fn a_restored_state_continues_as_the_saved_one() {
    let mut world = gridworld("()");
    walk(&mut world, &[EAST, EAST, SOUTH]);
    let mut bytes = Vec::new();
    world.save(&mut bytes).unwrap();
    let mut other = gridworld("()");
    other.load(&bytes).unwrap();
    let (mut left, mut right) = (observe(&world), observe(&other));
    for action in [SOUTH, EAST, NORTH, WEST] {
        assert_eq!(world.step(&[action], &mut left).unwrap(), other.step(&[action], &mut right).unwrap());
        assert_eq!(left, right);
    }
}

#[test]
fn foreign_bytes_are_refused_and_change_nothing() {
    let mut world = gridworld(r##"(map: ["S.G", "#.."])"##);
    walk(&mut world, &[EAST]);
    let mut bytes = Vec::new();
    world.save(&mut bytes).unwrap();
    let mut in_wall = bytes.clone();
    let end = in_wall.len() - 8;
    in_wall[end..].copy_from_slice(&3u64.to_le_bytes());
    let mut outside = bytes.clone();
    outside[end..].copy_from_slice(&6u64.to_le_bytes());
    let mut of_another_map = Vec::new();
    gridworld(r#"(map: ["S.G", "..."])"#).save(&mut of_another_map).unwrap();
    let mut longer = bytes.clone();
    longer.push(0);
    for bad in [&b""[..], b"foreign", &bytes[1..], &longer, &in_wall, &outside, &of_another_map] {
        assert!(world.load(bad).is_err(), "{bad:?}");
        assert_eq!(world.cell, 1);
    }
}
