<% extends "c/base.c" %>
<% block summary %>forbids pushing hard<% endblock %>
<% block description %>Forbids pushing hard<% endblock %>

<% block abilities %>
static const float limit = 0.9f;

static int32_t needs(ShieldInstance *self, uint32_t *needs) {
    (void)self;
    /* SHIELD_NEED_VALUES asks for the reset ensemble's values of the proposed action. SHIELD_NEED_PROBABILITIES asks for undo
       probabilities, which a ShieldUndoRuleTable is given: the extension SHIELD_EXTENSION_UNDO_RULE. */
    *needs = 0;
    return SHIELD_STATUS_OK;
}

static int32_t evaluate(ShieldInstance *self, const ShieldRuleContextView *context, ShieldVerdictView *verdict) {
    if (!is_good(context->proposed, context->proposed.length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the action is not finite");
    }
    float largest = 0;
    for (size_t i = 0; i < context->proposed.length; i++) largest = fmaxf(largest, fabsf(context->proposed.pointer[i]));
    bool is_safe = largest <= limit;
    verdict->verdict = is_safe ? SHIELD_VERDICT_ALLOW : SHIELD_VERDICT_REJECT;
    verdict->score = largest;
    if (!is_safe && verdict->reason_capacity > 0) {
        int length = snprintf((char *)verdict->reason, verdict->reason_capacity, "the action reaches %g, more than %g",
                              (double)largest, (double)limit);
        size_t room = verdict->reason_capacity - 1;
        verdict->reason_length = (size_t)length < room ? (size_t)length : room;
    }
    return SHIELD_STATUS_OK;
}

/* |a| <= limit, two rows for each dimension: from these, the host finds the nearest action that is allowed. */
static int32_t linearise(
    ShieldInstance *self, const ShieldRuleContextView *context, ShieldFloats gradients, const ShieldRowSink *rows) {
    (void)gradients;
    size_t length = context->proposed.length;
    float *row = calloc(length, sizeof *row);
    if (!row) return fail(self, SHIELD_STATUS_FAILED, "no memory");
    int32_t status = SHIELD_STATUS_OK;
    for (size_t i = 0; i < 2 * length && status == SHIELD_STATUS_OK; i++) {
        row[i / 2] = i % 2 ? -1 : 1;
        status = rows->push(rows->context, row, length, limit);
        row[i / 2] = 0;
    }
    free(row);
    return status;
}

static int32_t observe(ShieldInstance *self, const ShieldObservedDecisionView *decision) {
    (void)self;
    (void)decision; /* here a rule may change its state, and in `observe_attempt` of the extension */
    return SHIELD_STATUS_OK;
}
<% endblock %>

<% block table %>
    .needs = needs,
    .evaluate = evaluate,
    .linearise = linearise,
    .observe = observe,
<% endblock %>
