//! The process of an isolated plugin: it loads one library, makes one instance and serves its calls.

use anyhow::Context;
use shield_api::{
    Checkpoint, Environment, Error, Policy, ResetKind, Result, Setup, Spaces,
    abi::{StepView, status},
    metrics::Metrics,
};
use shield_worker::{Client, Memory};

use super::protocol::{self, Created, Creation, IsolatedKind, Operation};
use crate::plugin::{LoadedEnvironment, LoadedPolicy, PluginError, host, library::Library};

/// Serves the host that started this process, until it has gone.
///
/// # Errors
/// The process is nobody's worker, or the channel broke.
pub fn serve() -> anyhow::Result<()> {
    let mut client = Client::from_environment()
        .context("`shield worker` is what isolated plugins run in; it is not meant to be called by hand")?;
    let mut guest = Guest::default();
    let (metrics, mut lines) = (Metrics::default(), String::new());
    while client.wait()? {
        metrics.collect(|| guest.answer(client.memory()));
        lines.clear();
        metrics.drain(&mut |name, mean| lines += &format!("{name}={mean}\n"));
        protocol::write_metrics(client.memory(), &lines);
        client.answer()?;
    }
    Ok(())
}

enum Instance {
    Environment(LoadedEnvironment),
    Policy(LoadedPolicy),
}

#[derive(Default)]
struct Guest {
    instance: Option<Instance>,
    action: Vec<f32>,
    observation: Vec<f32>,
    /// A state on its way in or out.
    state: Vec<u8>,
}

impl Guest {
    fn answer(&mut self, memory: &mut Memory) {
        let code = match self.serve(memory) {
            Ok(()) => status::OK,
            Err(error) => {
                let position = error.position().map_or([0, 0], |place| [place.line, place.column]);
                memory.write(protocol::POSITION, &position);
                protocol::write_text(memory, error.message());
                protocol::code(&error)
            }
        };
        memory.write(protocol::STATUS, &[code.cast_unsigned()]);
    }

    fn serve(&mut self, memory: &mut Memory) -> Result<()> {
        let code = memory.get(protocol::OPERATION);
        let operation = Operation::from_code(code)
            .ok_or_else(|| Error::invalid_argument(format!("there is no operation {code}")))?;
        if operation == Operation::Create {
            return self.create(memory);
        }
        let Self { instance: Some(instance), action, observation, state } = self else {
            return Err(Error::failed("no instance was made yet"));
        };
        let actions = protocol::NUMBERS;
        let observations = actions + size_of::<f32>() * action.len();
        match (operation, instance) {
            (Operation::Reset, Instance::Environment(environment)) => {
                environment.reset(memory.get(protocol::SEED), observation)?;
                memory.write(observations, observation);
            }
            (Operation::ResetTo, Instance::Environment(environment)) => {
                let start = protocol::read_text(memory);
                environment.reset_to(&start, memory.get(protocol::SEED), observation)?;
                memory.write(observations, observation);
            }
            (Operation::Step, Instance::Environment(environment)) => {
                memory.read(actions, action);
                let outcome = environment.step(action, observation)?;
                memory.write(observations, observation);
                let StepView { forward_reward, reset_reward, flags } = outcome.into();
                memory.write(protocol::REWARDS, &[forward_reward, reset_reward]);
                memory.write(protocol::FLAGS, &[flags]);
            }
            (Operation::ResetKind, Instance::Environment(environment)) => {
                memory.write(protocol::STATE, &[environment.reset_kind()? as u64]);
            }
            (Operation::Act, Instance::Policy(policy)) => {
                memory.read(observations, observation);
                policy.act(observation, action)?;
                memory.write(actions, action);
            }
            (Operation::Save, instance) => {
                state.clear();
                instance.checkpoint().save(state)?;
                memory.write(protocol::STATE, &[state.len() as u64]);
            }
            (Operation::TakePiece, _) => {
                let rest = state.get(offset(memory)..).unwrap_or_default();
                memory.write(protocol::NUMBERS, &rest[..rest.len().min(protocol::PIECE)]);
            }
            (Operation::GivePiece, instance) => {
                let total = usize::try_from(memory.get::<u64>(protocol::STATE)).unwrap_or(usize::MAX);
                let begin = offset(memory).min(total);
                state.resize(begin, 0);
                state.resize(total.min(begin + protocol::PIECE), 0);
                memory.read(protocol::NUMBERS, &mut state[begin..]);
                if state.len() == total {
                    instance.checkpoint().load(state)?;
                }
            }
            (operation, _) => {
                return Err(Error::unsupported(format!("{operation:?}")));
            }
        }
        Ok(())
    }

    fn create(&mut self, memory: &mut Memory) -> Result<()> {
        let creation: Creation = ron::from_str(&protocol::read_text(memory))
            .map_err(|error| Error::failed(format!("the request cannot be read: {error}")))?;
        let own = env!("CARGO_PKG_VERSION");
        if creation.version != own {
            return Err(Error::failed(format!(
                "the host is version {}, the program in which plugins are isolated {own}; {} names another",
                creation.version,
                super::WORKER_VARIABLE
            )));
        }
        let made = make(creation).map_err(|error| match error {
            PluginError::Create { kind, message, .. } => Error::new(kind, message),
            PluginError::Config { message, position, .. } => {
                let error = Error::invalid_config(message);
                position.map_or(error.clone(), |place| error.at(place.line, place.column))
            }
            other => Error::failed(other.to_string()),
        })?;
        let (instance, spaces) = made;
        if let Instance::Environment(environment) = &instance {
            let spec = environment.spec();
            let created = Created {
                spaces: (&spec.spaces).into(),
                episode_length: spec.episode_length,
                brings_reset_reward: spec.brings_reset_reward,
                starts: environment.starts(),
                reset_kinds: environment
                    .reset_kinds()
                    .into_iter()
                    .map(|ResetKind { name, cost }| (name, cost))
                    .collect(),
            };
            let text = ron::to_string(&created).map_err(|error| Error::failed(error.to_string()))?;
            if !protocol::fits(&text) {
                return Err(Error::failed("its spaces and starts are too many for an isolated plugin"));
            }
            protocol::write_text(memory, &text);
        }
        self.action = vec![0.0; spaces.action_len()];
        self.observation = vec![0.0; spaces.observation_len()];
        self.instance = Some(instance);
        Ok(())
    }
}

impl Instance {
    fn checkpoint(&mut self) -> &mut dyn Checkpoint {
        match self {
            Self::Environment(environment) => environment,
            Self::Policy(policy) => policy,
        }
    }
}

fn make(creation: Creation) -> Result<(Instance, Spaces), PluginError> {
    let Creation { kind, id, path, sha256, config, seed, threads, spaces, .. } = creation;
    let library = Library::load_isolated(&path, &id, sha256.as_deref())?;
    match (kind, spaces) {
        (IsolatedKind::Policy, Some(spaces)) => {
            let spaces = Spaces::from(spaces);
            let setup = Setup::with_spaces(seed, threads, host(), spaces.clone());
            let policy = LoadedPolicy::create(&id, library.table(&id)?, &config, &setup)?;
            Ok((Instance::Policy(policy), spaces))
        }
        _ => {
            let setup = Setup::new(seed, threads, host());
            let environment = LoadedEnvironment::create(&id, library.table(&id)?, &config, &setup)?;
            let spaces = environment.spec().spaces;
            Ok((Instance::Environment(environment), spaces))
        }
    }
}

fn offset(memory: &Memory) -> usize {
    usize::try_from(memory.get::<u64>(protocol::STATE + size_of::<u64>())).unwrap_or(usize::MAX)
}
