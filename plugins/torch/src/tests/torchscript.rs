//! Playing exported files. They are made here, by tracing.

use std::path::Path;

use shield_api::{ErrorKind, Host, Plugin, Policy, Setup, Space, Spaces};
use tch::{CModule, Tensor};

use crate::torchscript::{TorchScript, TorchScriptConfig};

/// A file whose actions are twice the first two of three observations.
fn export(folder: &Path) -> String {
    let path = folder.join("policy.pt");
    let mut doubled = |inputs: &[Tensor]| vec![inputs[0].narrow(1, 0, 2) * 2.0];
    let module = CModule::create_by_tracing(
        "Policy",
        "forward",
        &[Tensor::zeros([1, 3], tch::kind::FLOAT_CPU)],
        &mut doubled,
    );
    module.unwrap().save(&path).unwrap();
    path.to_str().unwrap().to_owned()
}

fn policy(path: String, in_unit_box: bool, observation_len: usize) -> shield_api::Result<TorchScript> {
    let action = Space::Box { low: vec![-2.0, 0.0], high: vec![2.0, 1.0] };
    policy_for(path, in_unit_box, observation_len, action)
}

fn policy_for(
    path: String,
    in_unit_box: bool,
    observation_len: usize,
    action: Space,
) -> shield_api::Result<TorchScript> {
    let spaces = Spaces { observation: Space::unbounded(observation_len), action };
    TorchScript::create(
        TorchScriptConfig { path, in_unit_box },
        &Setup::with_spaces(0, 1, Host::silent(), spaces),
    )
}

#[test]
fn the_actions_are_those_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = export(folder.path());
    let mut action = [9.0; 2];
    policy(path.clone(), false, 3).unwrap().act(&[0.3, -0.2, 0.7], &mut action).unwrap();
    assert_eq!(action, [0.6, -0.4]);
    policy(path, true, 3).unwrap().act(&[0.3, -0.2, 0.7], &mut action).unwrap();
    assert_eq!(action, [1.2, 0.3]);
}

#[test]
fn an_unusable_file_is_refused_before_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = export(folder.path());
    let no_module = folder.path().join("text.pt");
    std::fs::write(&no_module, "no module").unwrap();
    let refused = [
        policy(path, false, 1).err(),
        policy(no_module.to_str().unwrap().to_owned(), false, 3).err(),
        policy(String::new(), false, 3).err(),
    ];
    for error in refused {
        assert_eq!(error.unwrap().kind(), ErrorKind::InvalidConfig);
    }
}

#[test]
fn wrong_arguments_and_non_finite_answers_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut policy = policy(export(folder.path()), false, 3).unwrap();
    let mut action = [0.0; 2];
    assert!(policy.act(&[f32::NAN, 0.0, 0.0], &mut action).is_err());
    assert!(policy.act(&[0.0; 2], &mut action).is_err());
    assert!(policy.act(&[0.0; 3], &mut [0.0; 3]).is_err());
    assert!(policy.act(&[f32::MAX, 0.0, 0.0], &mut action).is_err(), "twice the largest number is infinite");
}

#[test]
fn the_policy_of_the_example_drives_to_its_goal() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/policies/cart.pt");
    let mut cart = policy_for(path.into(), true, 6, Space::uniform(1, -2.0, 2.0)).unwrap();
    for (position, velocity) in [(0.0, 0.0), (0.9, 0.0), (0.85, 0.2), (1.0, -0.1)] {
        let mut action = [9.0];
        cart.act(&[position, 0.3, 0.1, velocity, 0.2, 0.4], &mut action).unwrap();
        let expected = 2.0 * (6.0 * (0.9 - position) - 2.0 * velocity).tanh();
        assert!((action[0] - expected).abs() < 1e-5, "{action:?}, not {expected}");
    }
}
