//! The configuration, and how its RON values become Python's.

use std::{collections::BTreeMap, time::Duration};

use serde_json::Value as Json;
use shield_api::{Error, Result};

shield_api::config! {
    /// Which environment, and which Python runs it.
    pub struct GymnasiumConfig {
        /// The environment's id, for example "Pendulum-v1".
        id: String = String::new() => "\"\"",
        /// The interpreter, for example ".venv/bin/python". It needs gymnasium.
        python: String = "python3".into() => "\"python3\"",
        /// A module to import first, which registers environments of its own. The working directory is searched too.
        import: String = String::new() => "\"\"",
        /// Arguments of the environment, for example {"terminate_when_unhealthy": false}.
        kwargs: BTreeMap<String, ron::Value> = BTreeMap::new() => "{}",
        /// The most steps of an episode. None: the time limit with which the environment is registered.
        episode_length: Option<usize> = None,
        /// How long Python may take to make the environment, in seconds.
        start_timeout_s: f64 = 120.0,
        /// How long a step or a reset may take, in seconds.
        step_timeout_s: f64 = 30.0,
    }
}

impl GymnasiumConfig {
    /// The arguments as JSON.
    pub fn json_kwargs(&self) -> Result<serde_json::Map<String, Json>> {
        let entry = |(name, value): (&String, &ron::Value)| {
            let value = json(name, value).map_err(|error| error.in_field(format!("kwargs.{name}")))?;
            Ok((name.clone(), value))
        };
        self.kwargs.iter().map(entry).collect()
    }
}

/// A time limit, if it is one.
pub fn seconds(field: &str, value: f64) -> Result<Duration> {
    Duration::try_from_secs_f64(value).ok().filter(|duration| !duration.is_zero()).ok_or_else(|| {
        let message = format!("`{field}` is {value}; a time limit is finite and above 0");
        Error::invalid_config(message).in_field(field)
    })
}

fn json(name: &str, value: &ron::Value) -> Result<Json> {
    let refused = |what: &str| Error::invalid_config(format!("`kwargs`: {name:?} holds {what}"));
    Ok(match value {
        ron::Value::Unit | ron::Value::Option(None) => Json::Null,
        ron::Value::Option(Some(value)) => json(name, value)?,
        ron::Value::Bool(value) => Json::from(*value),
        ron::Value::Char(value) => Json::from(value.to_string()),
        ron::Value::String(value) => Json::from(value.as_str()),
        ron::Value::Number(number) => {
            let whole = (*number).into_f64();
            let is_float = matches!(number, ron::Number::F32(_) | ron::Number::F64(_));
            if is_float {
                let float = serde_json::Number::from_f64(whole);
                Json::Number(float.ok_or_else(|| refused(&format!("{whole}, which JSON cannot carry")))?)
            } else {
                serde_json::to_value(number).map_err(|error| refused(&error.to_string()))?
            }
        }
        ron::Value::Seq(values) => {
            Json::Array(values.iter().map(|value| json(name, value)).collect::<Result<_>>()?)
        }
        ron::Value::Map(entries) => {
            let entries = entries.iter().map(|(key, value)| match key {
                ron::Value::String(key) => Ok((key.clone(), json(name, value)?)),
                _ => Err(refused("a map whose keys are not strings")),
            });
            Json::Object(entries.collect::<Result<_>>()?)
        }
        ron::Value::Bytes(_) => return Err(refused("bytes, which JSON cannot carry")),
    })
}
