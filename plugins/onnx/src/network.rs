//! A network in ONNX with one input, behind plain numbers.

use std::{
    fs::File,
    io::{Read as _, Seek as _, SeekFrom},
    path::Path,
    sync::Arc,
};

use shield_api::{Error, Result, regular_file};
use tract_onnx::data_resolver::ModelDataResolver;
use tract_onnx::model::ParseResult;
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::{
    infer::Factoid,
    internal::{DimLike, TractErrorContext as _, bail},
};

/// A network that was read, checked against the observation, and prepared for a batch of one.
pub struct Network {
    plan: Arc<TypedRunnableModel>,
    input: Vec<usize>,
    input_type: DatumType,
    output: Vec<usize>,
}

impl Network {
    /// Reads the file at `path` for observations of `observation_len` values. Only the first output is used and computed.
    pub fn read(path: &str, observation_len: usize) -> Result<Self> {
        let refused = |reason: String| Error::invalid_config(format!("`path`: {path}: {reason}"));
        if path.is_empty() {
            return Err(Error::invalid_config("`path` names no file; give the policy's .onnx file"));
        }
        let file = regular_file::open(path).map_err(|error| {
            refused(format!("cannot be read: {error}; a relative path counts from the working directory"))
        })?;
        let model = parse(Path::new(path), file)
            .map_err(|error| refused(format!("is not a network in ONNX that can be read: {error:#}")))?;
        let (input, input_type) = input_shape(&model, observation_len).map_err(&refused)?;
        Self::prepare(model, input, input_type)
            .map_err(|error| refused(format!("the network cannot be run: {error:#}")))
    }

    fn prepare(mut model: InferenceModel, input: Vec<usize>, input_type: DatumType) -> TractResult<Self> {
        let first = model.output_outlets()?[0];
        model.select_output_outlets(&[first])?;
        let fact = InferenceFact::dt_shape(input_type, input.as_slice());
        let plan = model.with_input_fact(0, fact)?.into_optimized()?.into_runnable()?;
        let mut network = Self { plan, input, input_type, output: Vec::new() };
        let zeros = vec![0.0; network.input.iter().product()];
        network.output = network.evaluate(&zeros)?.shape().to_vec();
        Ok(network)
    }

    /// The shape of the output, the batch of one included.
    pub fn output_shape(&self) -> &[usize] {
        &self.output
    }

    /// How many numbers the output has.
    pub fn output_len(&self) -> usize {
        self.output.iter().product()
    }

    /// Runs the network on an observation and hands its output over.
    pub fn run<R>(&self, observation: &[f32], take: impl FnOnce(&[f32]) -> R) -> Result<R> {
        let run = || -> TractResult<R> {
            let output = self.evaluate(observation)?;
            let output = output.cast_to::<f32>()?;
            Ok(take(output.try_as_plain_ram()?.as_slice::<f32>()?))
        };
        run().map_err(|error| Error::failed(format!("the network failed: {error:#}")))
    }

    fn evaluate(&self, observation: &[f32]) -> TractResult<TValue> {
        let input = Tensor::from_shape(&self.input, observation)?;
        let input = input.cast_to_dt(self.input_type)?.into_owned();
        let mut outputs = self.plan.run(tvec![input.into_tvalue()])?;
        Ok(outputs.swap_remove(0))
    }
}

/// The network in `file`, which is open at `path`. Its weights may lie in files beside it.
fn parse(path: &Path, mut file: File) -> TractResult<InferenceModel> {
    let mut onnx = onnx();
    onnx.provider = Arc::new(RegularFiles);
    let network = onnx.proto_model_for_read(&mut file)?;
    let ParseResult { model, unresolved_inputs, .. } =
        onnx.parse(&network, path.parent().and_then(Path::to_str))?;
    if !unresolved_inputs.is_empty() {
        bail!("no node gives the inputs {unresolved_inputs:?}");
    }
    Ok(model)
}

/// Reads weights beside a network from regular files, which never makes the program wait.
struct RegularFiles;

impl ModelDataResolver for RegularFiles {
    fn read_bytes_from_path(
        &self,
        bytes: &mut Vec<u8>,
        path: &Path,
        offset: usize,
        length: Option<usize>,
    ) -> TractResult<()> {
        let mut read = || {
            let mut file = regular_file::open(path)?;
            file.seek(SeekFrom::Start(offset as u64))?;
            file.take(length.map_or(u64::MAX, |length| length as u64)).read_to_end(bytes)
        };
        let count = read().with_context(|| format!("{} cannot be read", path.display()))?;
        match length {
            Some(length) if count < length => {
                bail!("{} ends before byte {}", path.display(), offset.saturating_add(length))
            }
            _ => Ok(()),
        }
    }
}

/// The shape of the network's one input for one observation: dimensions that the file leaves open are 1, but the last of them, which
/// takes what the others leave of the observation.
fn input_shape(model: &InferenceModel, observation_len: usize) -> Result<(Vec<usize>, DatumType), String> {
    let said = |error: TractError| format!("{error:#}");
    let inputs = model.input_outlets().map_err(said)?;
    if inputs.len() != 1 {
        let names: Vec<&str> = inputs.iter().map(|input| model.node(input.node).name.as_str()).collect();
        return Err(format!(
            "the network has the inputs [{}]; a policy has one, the observation. Export it with a single flat input",
            names.join(", ")
        ));
    }
    let fact = model.input_fact(0).map_err(said)?;
    let input_type = fact.datum_type.concretize().unwrap_or(f32::datum_type());
    let Some(rank) = fact.shape.rank().concretize() else {
        return Ok((vec![1, observation_len], input_type));
    };
    let dimensions: Vec<Option<usize>> = fact
        .shape
        .dims()
        .take(usize::try_from(rank).unwrap_or_default())
        .map(|dimension| dimension.concretize().and_then(|size| size.to_usize().ok()))
        .collect();
    let known: usize = dimensions.iter().flatten().product();
    let is_open = dimensions.contains(&None);
    let fits =
        if is_open { known > 0 && observation_len.is_multiple_of(known) } else { known == observation_len };
    if !fits {
        let name = &model.node(inputs[0].node).name;
        let shape: Vec<String> = dimensions
            .iter()
            .map(|size| size.map_or_else(|| "?".to_string(), |size| size.to_string()))
            .collect();
        return Err(format!(
            "its input {name:?} has the shape [{}], which no observation of {observation_len} values fills",
            shape.join(", ")
        ));
    }
    let last_open = dimensions.iter().rposition(Option::is_none);
    let fill = |(index, size): (usize, &Option<usize>)| match size {
        Some(size) => *size,
        None if Some(index) == last_open => observation_len / known,
        None => 1,
    };
    Ok((dimensions.iter().enumerate().map(fill).collect(), input_type))
}
