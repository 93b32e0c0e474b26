use std::{fs, os::unix::fs::PermissionsExt};

use shield_api::{Host, PluginConfig};

use super::*;

fn make(config: &str) -> Result<Gymnasium> {
    Gymnasium::create(GymnasiumConfig::parse(config).unwrap(), &Setup::new(0, 1, Host::silent()))
}

fn refused(config: &str) -> String {
    match make(config) {
        Ok(_) => panic!("{config} was accepted"),
        Err(error) => error.to_string(),
    }
}

/// An executable script that stands in for the interpreter.
fn script(content: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("python");
    fs::write(&path, content).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    let path = path.display().to_string();
    (folder, path)
}

#[test]
fn an_invalid_configuration_is_refused_with_the_reason() {
    for (config, expected) in [
        ("()", "`id` names no environment"),
        ("(id: \"A-v0\", python: \"/no/such/python\")", "/no/such/python"),
        ("(id: \"A-v0\", step_timeout_s: 0.0)", "`step_timeout_s` is 0"),
        ("(id: \"A-v0\", start_timeout_s: inf)", "`start_timeout_s` is inf"),
        ("(id: \"A-v0\", kwargs: {\"mass\": [1.0, inf]})", "`kwargs`: \"mass\" holds inf"),
        ("(id: \"A-v0\", kwargs: {\"masses\": {1: 2.0}})", "keys are not strings"),
    ] {
        assert!(refused(config).contains(expected), "{}", refused(config));
    }
}

#[test]
fn keyword_arguments_reach_python_unchanged() {
    let text = r#"(kwargs: {"a": 1, "b": 0.5, "c": "x", "d": [true, None], "e": {"f": Some(-3)}, "g": 2.0})"#;
    let kwargs = GymnasiumConfig::parse(text).unwrap().json_kwargs().unwrap();
    let expected = r#"{"a":1,"b":0.5,"c":"x","d":[true,null],"e":{"f":-3},"g":2.0}"#;
    assert_eq!(
        serde_json::Value::Object(kwargs),
        serde_json::from_str::<serde_json::Value>(expected).unwrap()
    );
}

#[test]
fn a_python_without_gymnasium_is_refused_with_the_remedy() {
    // Without the folder in which packages are installed.
    let (_folder, python) = script("#!/bin/sh\nexec python3 -I -S \"$@\"\n");
    let message = refused(&format!("(id: \"Pendulum-v1\", python: {python:?})"));
    assert!(message.contains("-m pip install gymnasium"), "{message}");
}

#[test]
fn a_program_that_is_not_python_is_refused_with_its_output_or_a_timeout() {
    let (_folder, python) = script("#!/bin/sh\necho I am a shell >&2\nexit 7\n");
    let message = refused(&format!("(id: \"Pendulum-v1\", python: {python:?})"));
    assert!(message.contains("exit code 7") && message.contains("I am a shell"), "{message}");
    assert!(message.contains(&python), "{message}");
    let (_folder, python) = script("#!/bin/sh\nexec sleep 60\n");
    let message = refused(&format!("(id: \"Pendulum-v1\", python: {python:?}, start_timeout_s: 0.3)"));
    assert!(message.contains("within 0.3 s") && message.contains("raise `start_timeout_s`"), "{message}");
}

/// These tests need a Python with Gymnasium: `cargo xtask test --peers` names it.
#[cfg(feature = "python-tests")]
mod with_gymnasium {
    use std::{env, path::PathBuf};

    use shield_api::ErrorKind;

    use super::*;

    fn python() -> String {
        let named =
            env::var("SHIELD_PEERS_PYTHON").expect("`cargo xtask test --peers` names the interpreter");
        let path = PathBuf::from(named);
        assert!(path.exists(), "{} does not exist", path.display());
        path.display().to_string()
    }

    /// An interpreter that finds the module `worlds`.
    fn with_worlds() -> (tempfile::TempDir, String) {
        let tests = concat!(env!("CARGO_MANIFEST_DIR"), "/src/tests");
        script(&format!(
            "#!/bin/sh\nPYTHONPATH={tests:?} PYTHONDONTWRITEBYTECODE=1 exec {:?} \"$@\"\n",
            python()
        ))
    }

    fn world(kwargs: &str, extra: &str) -> Result<Gymnasium> {
        let (_folder, python) = with_worlds();
        make(&format!(
            "(id: \"Shield/World-v0\", import: \"worlds\", python: {python:?}, kwargs: {{{kwargs}}}, {extra})"
        ))
    }

    /// The error of the first step.
    fn failure(fault: &str) -> String {
        let mut world = world(&format!("\"fault\": {fault:?}"), "step_timeout_s: 1.0").unwrap();
        world.reset(0, &mut [0.0; 2]).unwrap();
        world.step(&[0.0; 2], &mut [0.0; 2]).unwrap_err().to_string()
    }

    #[test]
    fn gymnasium_tasks_keep_their_spaces_and_repeat_by_seed() {
        for (id, observed, action, length) in [
            ("Pendulum-v1", 3, Space::uniform(1, -2.0, 2.0), 200),
            ("CartPole-v1", 4, Space::Discrete { n: 2 }, 500),
            ("FrozenLake-v1", 16, Space::Discrete { n: 4 }, 100),
            ("HalfCheetah-v5", 17, Space::uniform(6, -1.0, 1.0), 1000),
        ] {
            let config = format!("(id: {id:?}, python: {:?})", python());
            let run = || {
                let mut world = make(&config).unwrap();
                let spec = world.spec();
                assert_eq!((spec.spaces.observation_len(), spec.episode_length), (observed, length), "{id}");
                assert_eq!(spec.spaces.action, action, "{id}");
                let mut observation = vec![f32::NAN; observed];
                let mut seen = Vec::new();
                world.reset(5, &mut observation).unwrap();
                let action = vec![1.0; action.action_len()];
                for _ in 0..5 {
                    let outcome = world.step(&action, &mut observation).unwrap();
                    seen.push((observation.clone(), outcome));
                    if outcome.terminated {
                        break;
                    }
                }
                seen
            };
            assert_eq!(run(), run(), "{id}");
        }
    }

    #[test]
    fn a_time_limit_does_not_terminate_the_environment() {
        let mut world = world("", "").unwrap();
        assert_eq!(world.spec().episode_length, 3);
        let mut observation = [0.0; 2];
        world.reset(0, &mut observation).unwrap();
        for step in 1..=8 {
            let outcome = world.step(&[0.5; 2], &mut observation).unwrap();
            assert_eq!((outcome.forward_reward, observation[0]), (step as f32, step as f32));
            assert_eq!((outcome.success, outcome.terminated), (step == 2, step == 8));
        }
    }

    #[test]
    fn the_seed_reaches_the_environment() {
        let mut world = world("", "").unwrap();
        let mut draw = |seed| {
            let mut observation = [0.0; 2];
            world.reset(seed, &mut observation).unwrap();
            observation[1]
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
        draw(u64::MAX);
    }

    #[test]
    fn a_space_of_several_parts_is_flattened() {
        let mut world =
            world("\"observation\": \"mixed\", \"action\": \"from 3\"", "episode_length: Some(9)").unwrap();
        assert_eq!(world.spec().episode_length, 9);
        let mut observation = [f32::NAN; 7];
        world.reset(0, &mut observation).unwrap();
        // The parts of a Dict come in the order of its own; one-hot for the Discrete one.
        let mut sorted = observation;
        sorted.sort_by(f32::total_cmp);
        assert_eq!(sorted, [0.0, 0.0, 0.0, 0.25, 0.5, 1.0, 1.0]);
        for action in [0.0, 1.0] {
            world.step(&[action], &mut observation).unwrap();
        }
        assert!(world.step(&[2.0], &mut observation).is_err());
    }

    #[test]
    fn an_unsupported_space_or_argument_is_refused_with_the_reason() {
        for (kwargs, expected) in [
            ("\"action\": \"unbounded\"", "infinite bounds"),
            ("\"action\": \"several\"", "MultiDiscrete"),
            ("\"observation\": \"sequence\"", "no fixed number"),
            ("\"colour\": 1", "unexpected keyword argument 'colour'"),
        ] {
            let message = world(kwargs, "").err().unwrap().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn an_unknown_id_or_module_is_refused_by_name() {
        let python = python();
        let message = refused(&format!("(id: \"Pendulumm-v1\", python: {python:?})"));
        assert!(message.contains("`id`") && message.contains("Pendulum"), "{message}");
        let message = refused(&format!("(id: \"A-v0\", import: \"no_such\", python: {python:?})"));
        assert!(message.contains("`import`: 'no_such'"), "{message}");
        let (_folder, python) = with_worlds();
        let endless = format!("id: \"Shield/Endless-v0\", import: \"worlds\", python: {python:?}");
        assert!(refused(&format!("({endless})")).contains("give `episode_length`"));
        assert!(refused(&format!("({endless}, episode_length: Some(0))")).contains("`episode_length` is 0"));
    }

    #[test]
    fn a_failing_environment_is_reported_with_the_cause() {
        for (fault, expected) in [
            ("dies", "exit code 3"),
            ("dies", "out of licences"),
            ("hangs", "raise `step_timeout_s`"),
            ("raises", "RuntimeError: the gripper is stuck"),
            ("NaN", "observation[1] is NaN"),
            ("NaN reward", "reward is NaN"),
            ("short", "the observation has 1 values"),
        ] {
            let message = failure(fault);
            assert!(message.contains(expected) && message.contains("Shield/World-v0"), "{message}");
        }
    }

    #[test]
    fn a_frame_shows_what_the_environment_renders() {
        let mut world = world("", "").unwrap();
        assert_eq!(world.frame_size(), [320, 240], "before the first reset");
        let mut observation = [0.0; 2];
        world.reset(0, &mut observation).unwrap();
        world.step(&[0.5; 2], &mut observation).unwrap();
        assert_eq!(world.frame_size(), [4, 2]);
        let mut draw = |width: usize, height: usize| {
            let mut pixels = vec![0; 3 * width * height];
            world.render(&mut Frame::new(width, height, &mut pixels).unwrap()).unwrap();
            pixels
        };
        let pixel = |column: u8, row: u8| [column, 100 * row, 1];
        assert_eq!(draw(4, 2), (0..8).flat_map(|index| pixel(index % 4, index / 4)).collect::<Vec<_>>());
        assert_eq!(draw(2, 1), [pixel(0, 0), pixel(2, 0)].concat());
        assert_eq!(draw(8, 2)[..9], [pixel(0, 0), pixel(0, 0), pixel(1, 0)].concat());
        world.step(&[0.5; 2], &mut observation).unwrap();
        assert_eq!(observation[0], 2.0, "drawing changes nothing");
    }

    #[test]
    fn an_environment_that_cannot_be_rendered_is_reported_with_the_reason() {
        for (kwargs, expected) in [
            ("\"fault\": \"grey\"", "shape (2, 4) is not height"),
            ("\"render_mode\": None", "render_mode is None"),
        ] {
            let mut world = world(kwargs, "").unwrap();
            world.reset(0, &mut [0.0; 2]).unwrap();
            let error = world.render(&mut Frame::new(1, 1, &mut [0; 3]).unwrap()).unwrap_err();
            assert!(
                error.kind() == ErrorKind::Unsupported && error.to_string().contains(expected),
                "{error}"
            );
        }
    }

    #[test]
    fn an_environment_may_print() {
        let mut world = world("\"fault\": \"prints\"", "").unwrap();
        let mut observation = [0.0; 2];
        world.reset(0, &mut observation).unwrap();
        for _ in 0..20 {
            world.step(&[0.0; 2], &mut observation).unwrap();
        }
        let error = world.step(&[2.0, 0.0], &mut observation).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
    }
}
