//! A loaded abort rule.

use std::{
    ffi::c_void,
    fmt::Write,
    panic::{AssertUnwindSafe, catch_unwind},
    ptr,
};

use shield_api::{
    AbortRule, Error, Needs, ObservedAttempt, ObservedDecision, Phase, Reason, Result, Rows, RuleContext,
    RuleVerdict, Setup, Spaces, Verdict,
    abi::{
        AbortRuleTable, EXTENSION_UNDO_RULE, Floats, ObservedAttemptView, ObservedDecisionView, RowSink,
        RuleContextView, UndoRuleTable, UndoView, VerdictView, need, phase, status, verdict,
    },
    check_finite,
};

use super::handle::{Handle, checkpoint, described_wrongly, extension, spaces, while_creating};
use crate::plugin::PluginError;

/// Room for a rule's sentence; more is cut.
const REASON_BYTES: usize = 256;

/// An abort rule behind the binary interface.
#[derive(Debug)]
pub struct LoadedAbortRule {
    handle: Handle,
    table: &'static AbortRuleTable,
    /// Of a rule of 1.1 or later.
    undo: Option<&'static UndoRuleTable>,
    needs: Needs,
    spaces: Spaces,
}

checkpoint!(LoadedAbortRule);

impl LoadedAbortRule {
    pub(in crate::plugin) fn create(
        id: &str,
        table: &'static AbortRuleTable,
        config: &str,
        setup: &Setup,
    ) -> Result<Self, PluginError> {
        let spaces = spaces(id, setup)?;
        let handle = Handle::create(id, &table.life, config, setup)?;
        let mut bits = 0;
        handle
            // SAFETY: the instance is of this table; the place lives for the call.
            .call(|instance| unsafe { (table.needs)(instance, &mut bits) })
            .map_err(|error| while_creating(id, &error))?;
        let known = need::VALUES
            | need::GREEDY_VALUES
            | need::FORWARD_VALUES
            | need::PROBABILITIES
            | need::GREEDY_PROBABILITIES
            | need::GREEDY_ON_REJECTION;
        if bits & !known != 0 {
            return Err(described_wrongly(
                id,
                format!("`needs` asks for what this host does not know: {bits:#x}"),
            ));
        }
        let needs = Needs {
            values: bits & need::VALUES != 0,
            greedy_values: bits & need::GREEDY_VALUES != 0,
            forward_values: bits & need::FORWARD_VALUES != 0,
            probabilities: bits & need::PROBABILITIES != 0,
            greedy_probabilities: bits & need::GREEDY_PROBABILITIES != 0,
            greedy_on_rejection: bits & need::GREEDY_ON_REJECTION != 0,
        };
        // SAFETY: under this name a rule gives this table.
        let undo = unsafe { extension(id, &table.life, EXTENSION_UNDO_RULE)? };
        if needs.undo_probabilities() && undo.is_none() {
            let message = format!(
                "`needs` asks for undo probabilities, but there is no extension {EXTENSION_UNDO_RULE:?}, which takes them"
            );
            return Err(described_wrongly(id, message));
        }
        Ok(Self { handle, table, undo, needs, spaces })
    }

    /// The functions to be called instead of those of 1.0, where the rule needs undo probabilities.
    fn undo_table(&self) -> Option<&'static UndoRuleTable> {
        self.undo.filter(|_| self.needs.undo_probabilities())
    }

    fn check_context(&self, context: &RuleContext<'_>) -> Result<()> {
        let action_len = self.spaces.action_len();
        self.handle.require_length("observation", context.observation, self.spaces.observation_len())?;
        self.handle.require_length("proposed action", context.proposed, action_len)?;
        match context.previous {
            Some(previous) => self.handle.require_length("previous action", previous, action_len),
            None => Ok(()),
        }
    }
}

fn undo_view(context: &RuleContext<'_>) -> UndoView {
    UndoView {
        struct_size: size_of::<UndoView>(),
        probabilities: Floats::new(context.probabilities),
        greedy_probabilities: Floats::new(context.greedy_probabilities),
        start_probabilities: Floats::new(context.start_probabilities),
    }
}

fn view(context: &RuleContext<'_>) -> RuleContextView {
    RuleContextView {
        struct_size: size_of::<RuleContextView>(),
        step: context.step,
        observation: Floats::new(context.observation),
        proposed: Floats::new(context.proposed),
        previous: context.previous.map_or(Floats::none(), Floats::new),
        values: Floats::new(context.values),
        greedy_values: Floats::new(context.greedy_values),
        forward_values: Floats::new(context.forward_values),
        discount: context.discount,
        phase: match context.phase {
            Phase::Forward => phase::FORWARD,
            Phase::Reset => phase::RESET,
        },
    }
}

impl AbortRule for LoadedAbortRule {
    fn needs(&self) -> Needs {
        self.needs
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        self.check_context(context)?;
        let (context, undo) = (view(context), undo_view(context));
        let mut room = [0; REASON_BYTES];
        let mut judged = VerdictView {
            verdict: 0,
            score: f32::NAN,
            reason: room.as_mut_ptr(),
            reason_capacity: room.len(),
            reason_length: 0,
        };
        // SAFETY: the instance is of these tables; context, probabilities and verdict live for the call.
        self.handle.call(|instance| unsafe {
            match self.undo_table() {
                Some(table) => (table.evaluate)(instance, &context, &undo, &mut judged),
                None => (self.table.evaluate)(instance, &context, &mut judged),
            }
        })?;
        if judged.score.is_nan() {
            return Err(self.handle.broken("`evaluate` gave NaN for the score"));
        }
        let Some(sentence) = room.get(..judged.reason_length) else {
            return Err(self.handle.broken(format!(
                "`evaluate` says that it wrote {} bytes of a reason into room for {REASON_BYTES}",
                judged.reason_length
            )));
        };
        let verdict = match judged.verdict {
            verdict::ALLOW => Verdict::Allow,
            verdict::REJECT => Verdict::Reject,
            other => return Err(self.handle.broken(format!("`evaluate` gave the unknown verdict {other}"))),
        };
        for chunk in sentence.utf8_chunks() {
            reason.write_str(chunk.valid()).ok();
        }
        Ok(RuleVerdict { verdict, score: judged.score })
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        self.check_context(context)?;
        if !gradients.is_empty() {
            let estimates = if self.needs.probabilities { context.probabilities } else { context.values };
            let expected = estimates.len() * context.proposed.len();
            self.handle.require_length("gradients", gradients, expected)?;
        }
        let mut collector = Collector { rows, action_len: self.spaces.action_len(), error: None };
        let sink = RowSink { context: ptr::from_mut(&mut collector).cast(), push: push_row };
        let (context, undo, gradients) = (view(context), undo_view(context), Floats::new(gradients));
        // SAFETY: the instance is of these tables; context, probabilities, gradients and sink live for the call.
        let called = self.handle.call(|instance| unsafe {
            match self.undo_table() {
                Some(table) => (table.linearise)(instance, &context, &undo, gradients, &sink),
                None => (self.table.linearise)(instance, &context, gradients, &sink),
            }
        });
        match collector.error {
            // The rule may have gone on after a refused row; its rows are incomplete then.
            Some(error) => Err(self.handle.error(error.kind(), format!("`linearise`: {}", error.message()))),
            None => called,
        }
    }

    fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        self.handle.require_length("action", decision.action, self.spaces.action_len())?;
        let view = ObservedDecisionView {
            struct_size: size_of::<ObservedDecisionView>(),
            step: decision.step,
            action: Floats::new(decision.action),
            aborted: u32::from(decision.aborted),
        };
        // SAFETY: the instance is of this table; the decision lives for the call.
        self.handle.call(|instance| unsafe { (self.table.observe)(instance, &view) })
    }

    fn observe_attempt(&mut self, attempt: &ObservedAttempt) -> Result<()> {
        let Some(table) = self.undo else { return Ok(()) };
        let view = ObservedAttemptView {
            struct_size: size_of::<ObservedAttemptView>(),
            step: attempt.step,
            succeeded: u32::from(attempt.succeeded),
        };
        // SAFETY: the instance is of this plugin; the attempt lives for the call.
        self.handle.call(|instance| unsafe { (table.observe_attempt)(instance, &view) })
    }
}

/// Passes rows on to the caller, as far as they are such.
struct Collector<'a> {
    rows: &'a mut dyn Rows,
    action_len: usize,
    error: Option<Error>,
}

impl Collector<'_> {
    fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
        check_finite("the row", coefficients, self.action_len)?;
        check_finite("the bound", &[bound], 1)?;
        self.rows.push(coefficients, bound)
    }
}

unsafe extern "C" fn push_row(
    context: *mut c_void,
    coefficients: *const f32,
    length: usize,
    bound: f32,
) -> i32 {
    // SAFETY: `linearise` gave the context, a collector that lives for its call.
    let Some(collector) = (unsafe { context.cast::<Collector<'_>>().as_mut() }) else {
        return status::INVALID_ARGUMENT;
    };
    let pushed = if coefficients.is_null() || length != collector.action_len {
        // Not even looked at: the length may be as wrong as the pointer.
        Err(Error::invalid_argument(format!(
            "the row has {length} values, expected {}",
            collector.action_len
        )))
    } else {
        // SAFETY: not null, and the plugin's values live for the call.
        let coefficients = unsafe { std::slice::from_raw_parts(coefficients, length) };
        catch_unwind(AssertUnwindSafe(|| collector.push(coefficients, bound)))
            .unwrap_or_else(|_| Err(Error::failed("the host panicked while it took a row")))
    };
    match pushed {
        Ok(()) => status::OK,
        Err(error) => {
            collector.error.get_or_insert(error);
            status::INVALID_ARGUMENT
        }
    }
}
