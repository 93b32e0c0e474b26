<% extends "c/base.c" %>
<% set saved = "probability" %>
<% set keeps_lengths = true %>
<% block summary %>the same undo probability everywhere; put a real critic here<% endblock %>
<% block description %>The same undo probability everywhere<% endblock %>

<% block fields %>
    float probability;
<% endblock %>

<% block create %>
    self->probability = 0.5f;
<% endblock %>

<% block abilities %>
/* Whether there are `length` numbers in [0, 1]. */
static bool are_shares(ShieldFloats values, size_t length) {
    if (!is_good(values, length)) return false;
    for (size_t i = 0; i < length; i++) {
        if (values.pointer[i] < 0 || values.pointer[i] > 1) return false;
    }
    return true;
}

static int32_t info(ShieldInstance *self, ShieldLearnerInfoView *info) {
    (void)self;
    *info = (ShieldLearnerInfoView){.members = 1, .discount = 1};
    return SHIELD_STATUS_OK;
}

/* A success critic has the table of a learner, but does not act; and it learns through its extension alone. */
static int32_t no_action(ShieldInstance *self, ShieldFloats observation, uint32_t mode, float *action, size_t length) {
    (void)observation;
    (void)mode;
    (void)action;
    (void)length;
    return fail(self, SHIELD_STATUS_UNSUPPORTED, "a success critic does not act");
}

static int32_t no_update(ShieldInstance *self, const ShieldBatchView *batch) {
    (void)batch;
    return fail(self, SHIELD_STATUS_UNSUPPORTED, "a success critic learns from attempts");
}

static int32_t probabilities(
    ShieldInstance *self, ShieldFloats observation, ShieldFloats action, float *probabilities, size_t members) {
    if (members != 1 || !is_good(observation, self->observation_length) || !is_good(action, self->action_length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "a wrong length, or not finite");
    }
    probabilities[0] = self->probability;
    return SHIELD_STATUS_OK;
}

static int32_t gradients(ShieldInstance *self, ShieldFloats observation, ShieldFloats action, float *values, size_t members,
                         float *gradients, size_t gradients_length) {
    int32_t status = probabilities(self, observation, action, values, members);
    if (status != SHIELD_STATUS_OK) return status;
    for (size_t i = 0; i < gradients_length; i++) gradients[i] = 0;
    return SHIELD_STATUS_OK;
}

static int32_t update(ShieldInstance *self, const ShieldAttemptBatchView *batch) {
    size_t size = batch->size;
    bool is_sound = is_good(batch->observations, size * self->observation_length) &&
                    is_good(batch->actions, size * self->action_length) &&
                    is_good(batch->next_observations, size * self->observation_length) &&
                    is_good(batch->next_actions, size * self->action_length) && are_shares(batch->successes, size) &&
                    are_shares(batch->continuations, size) && are_shares(batch->outcomes, size) &&
                    are_shares(batch->outcome_weights, size) && are_shares(batch->masks, size);
    /* Refused as a whole: either every transition is learned, or nothing has changed. */
    if (!is_sound) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the batch has a wrong length or an impossible number");
    for (size_t i = 0; i < size; i++) {
        /* 1 in the reset set and 0 where nothing follows; else the outcome, as far as it counts, and what comes next. */
        float weight = batch->outcome_weights.pointer[i], success = batch->successes.pointer[i];
        float later = weight * batch->outcomes.pointer[i] + (1 - weight) * self->probability;
        float target = success + (1 - success) * batch->continuations.pointer[i] * later;
        float moved = self->probability + 0.1f * batch->masks.pointer[i] * (target - self->probability);
        self->probability = fminf(fmaxf(moved, 0), 1);
    }
    return SHIELD_STATUS_OK;
}
<% endblock %>

<% block extension %>
static const void *get_extension(ShieldText name) {
    static const ShieldSuccessCriticTable learning = {.struct_size = sizeof learning, .update = update};
    static const char critic[] = SHIELD_EXTENSION_SUCCESS_CRITIC;
    bool is_critic = name.length == sizeof critic - 1 && memcmp(name.pointer, critic, name.length) == 0;
    return is_critic ? &learning : NULL;
}
<% endblock %>

<% block table %>
    .info = info,
    .act = no_action,
    .q_values = probabilities,
    .q_gradients = gradients,
    .update = no_update,
<% endblock %>
