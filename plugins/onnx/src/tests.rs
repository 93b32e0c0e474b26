use prost::Message as _;
use shield_api::{ErrorKind, Host, PluginConfig};
use tract_onnx::{
    onnx,
    pb::{StringStringEntryProto, tensor_proto::DataLocation},
    prelude::Framework as _,
};

use super::*;

fn spaces(observed: usize, action: Space) -> Spaces {
    Spaces { observation: Space::unbounded(observed), action }
}

fn two_actions() -> Space {
    Space::Box { low: vec![-1.0, -4.0], high: vec![3.0, 4.0] }
}

fn four() -> Space {
    Space::Discrete { n: 4 }
}

fn path(name: &str) -> String {
    format!("{}/src/tests/networks/{name}.onnx", env!("CARGO_MANIFEST_DIR"))
}

fn make(name: &str, extra: &str, spaces: Spaces) -> Result<Onnx> {
    let config = OnnxConfig::parse(&format!("(path: {:?}, {extra})", path(name))).unwrap();
    Onnx::create(config, &Setup::with_spaces(0, 1, Host::silent(), spaces))
}

fn act(name: &str, extra: &str, action_space: Space, observation: [f32; 3]) -> Vec<f32> {
    let mut action = vec![f32::NAN; action_space.action_len()];
    let mut policy = make(name, extra, spaces(3, action_space)).unwrap();
    policy.act(&observation, &mut action).unwrap();
    action
}

fn refused(name: &str, extra: &str, spaces: Spaces) -> String {
    let Err(error) = make(name, extra, spaces) else { panic!("{name} was accepted") };
    assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{error}");
    error.to_string()
}

#[test]
fn an_export_with_another_shape_or_type_is_not_understood() {
    for name in ["flat", "three_outputs", "double"] {
        assert_eq!(act(name, "", two_actions(), [0.5, 0.25, -1.0]), [0.75, -2.0], "{name}");
    }
    let squashed = act("batched", "", two_actions(), [0.5, 0.25, -1.0]);
    let expected = [0.75_f32.tanh(), (-2.0_f32).tanh()];
    assert!(
        squashed.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-6),
        "{squashed:?}"
    );
}

#[test]
fn a_squashed_action_is_not_stretched_to_the_bounds() {
    for (observation, expected) in [([0.0, 0.0, 100.0], [1.0, 4.0]), ([-100.0, 0.0, 0.0], [-1.0, 0.0])] {
        let action = act("batched", "output: Normalised", two_actions(), observation);
        // The tanh is an approximation.
        let is_close = action.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-4);
        assert!(is_close, "{action:?}");
    }
}

#[test]
fn an_action_beyond_a_bound_is_not_moved_onto_it() {
    assert_eq!(act("flat", "", two_actions(), [9.0, 0.0, -9.0]), [3.0, -4.0]);
}

#[test]
fn the_best_of_discrete_actions_is_not_chosen() {
    for name in ["values", "index"] {
        for (observation, expected) in
            [([5.0, 1.0, 1.0], 0.0), ([0.0, 2.0, 1.0], 1.0), ([1.0, 1.0, 3.0], 3.0)]
        {
            assert_eq!(act(name, "", four(), observation), [expected], "{name}");
        }
    }
}

#[test]
fn a_missing_or_broken_file_is_not_named() {
    let message = refused("nowhere", "", spaces(3, two_actions()));
    assert!(message.contains("nowhere.onnx") && message.contains("working directory"), "{message}");
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), b"no network").unwrap();
    let config = OnnxConfig { path: file.path().display().to_string(), ..OnnxConfig::default() };
    let setup = Setup::with_spaces(0, 1, Host::silent(), spaces(3, two_actions()));
    let message = Onnx::create(config, &setup).err().unwrap().to_string();
    assert!(message.contains("ONNX"), "{message}");
    let message = Onnx::create(OnnxConfig::default(), &setup).err().unwrap().to_string();
    assert!(message.contains("`path` names no file"), "{message}");
}

/// The network "flat", whose weights lie in the file `weights` beside it.
fn with_weights_beside(folder: &std::path::Path) -> OnnxConfig {
    let mut network = onnx().proto_model_for_path(path("flat")).unwrap();
    let weights = &mut network.graph.as_mut().unwrap().initializer[0];
    let bytes: Vec<u8> = weights.float_data.drain(..).flat_map(f32::to_le_bytes).collect();
    let beside = [("location", "weights"), ("offset", "4"), ("length", "24")];
    weights.data_location = Some(DataLocation::External as i32);
    weights.external_data = beside.map(|(key, value)| entry(key, value)).into();
    std::fs::write(folder.join("weights"), [&[0; 4], bytes.as_slice()].concat()).unwrap();
    let file = folder.join("network.onnx");
    std::fs::write(&file, network.encode_to_vec()).unwrap();
    OnnxConfig { path: file.display().to_string(), ..OnnxConfig::default() }
}

fn entry(key: &str, value: &str) -> StringStringEntryProto {
    StringStringEntryProto { key: key.into(), value: value.into() }
}

#[test]
fn a_network_and_its_weights_are_read_from_regular_files_alone() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = |path: &std::path::Path| {
        assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
    };
    let setup = Setup::with_spaces(0, 1, Host::silent(), spaces(3, two_actions()));
    let config = with_weights_beside(folder.path());
    let mut action = [0.0; 2];
    Onnx::create(config.clone(), &setup).unwrap().act(&[0.5, 0.25, -1.0], &mut action).unwrap();
    assert_eq!(action, [0.75, -2.0]);

    let refused = |config: OnnxConfig| Onnx::create(config, &setup).err().unwrap().to_string();
    let weights = folder.path().join("weights");
    std::fs::write(&weights, [0; 27]).unwrap();
    let message = refused(config.clone());
    assert!(message.contains("weights ends before byte 28"), "{message}");
    std::fs::remove_file(&weights).unwrap();
    pipe(&weights);
    let message = refused(config);
    assert!(message.contains("weights cannot be read: it is a named pipe"), "{message}");

    let file = folder.path().join("pipe.onnx");
    pipe(&file);
    let message = refused(OnnxConfig { path: file.display().to_string(), ..OnnxConfig::default() });
    assert!(message.contains("pipe.onnx: cannot be read: it is a named pipe"), "{message}");
}

#[test]
fn a_network_of_other_shapes_is_accepted_or_its_shapes_not_named() {
    for (name, spaces, expected) in [
        ("flat", spaces(4, two_actions()), ["\"observation\" has the shape [3]", "4 values"]),
        ("batched", spaces(4, two_actions()), ["\"observation\" has the shape [?, 3]", "4 values"]),
        ("batched", spaces(3, Space::uniform(3, -1.0, 1.0)), ["[1, 2], 2 values", "action has 3"]),
        ("values", spaces(3, Space::Discrete { n: 5 }), ["[1, 4], 4 values", "5 actions"]),
        ("two_inputs", spaces(3, two_actions()), ["[left, right]", "single"]),
    ] {
        let message = refused(name, "", spaces);
        assert!(expected.iter().all(|part| message.contains(part)), "{message}");
    }
    assert!(refused("values", "output: Normalised", spaces(3, four())).contains("Normalised"));
}

#[test]
fn not_a_number_passes() {
    let mut policy = make("root", "", spaces(3, Space::uniform(3, -1.0, 1.0))).unwrap();
    let mut action = [0.0; 3];
    assert!(policy.act(&[1.0, f32::NAN, 1.0], &mut action).is_err());
    assert!(policy.act(&[1.0, -1.0, 1.0], &mut action).unwrap_err().message().contains("NaN"));
    policy.act(&[1.0, 0.0, 0.25], &mut action).unwrap();
    assert_eq!(action, [1.0, 0.0, 0.5]);
}

/// What `export_sb3.py` says of a policy.
#[derive(serde::Deserialize)]
struct Exported {
    name: String,
    output: String,
    observations: Vec<Vec<f32>>,
    actions: Vec<Vec<f32>>,
}

#[test]
#[ignore = "needs Stable-Baselines3: `cargo xtask test --python`"]
fn a_policy_of_stable_baselines_acts_otherwise_than_there() {
    let python =
        std::env::var("SHIELD_SB3_PYTHON").expect("`cargo xtask test --python` names the interpreter");
    let folder = tempfile::tempdir().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/src/tests/export_sb3.py");
    let status = std::process::Command::new(python).arg(script).arg(folder.path()).status().unwrap();
    assert!(status.success());
    let described = std::fs::read(folder.path().join("expected.json")).unwrap();
    let policies: Vec<Exported> = serde_json::from_slice(&described).unwrap();
    assert_eq!(policies.len(), 7);
    for Exported { name, output, observations, actions } in policies {
        let file = folder.path().join(format!("{name}.onnx"));
        let config = OnnxConfig::parse(&format!("(path: {file:?}, output: {output})")).unwrap();
        let action_space = if name.ends_with("Discrete") { four() } else { two_actions() };
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces(3, action_space));
        let mut policy = Onnx::create(config, &setup).unwrap_or_else(|error| panic!("{name}: {error}"));
        for (observation, expected) in observations.iter().zip(&actions) {
            let mut action = vec![f32::NAN; expected.len()];
            policy.act(observation, &mut action).unwrap();
            let is_near = action.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-4);
            assert!(is_near, "{name}: {action:?} for {observation:?}, not {expected:?}");
        }
    }
}
