<% extends "c/base.c" %>
<% set saved = "value" %>
<% set keeps_lengths = true %>
<% block summary %>the same value everywhere; put a real learner here<% endblock %>
<% block description %>The same value everywhere<% endblock %>

<% block fields %>
    float value;
<% endblock %>

<% block abilities %>
static int32_t info(ShieldInstance *self, ShieldLearnerInfoView *info) {
    (void)self;
    *info = (ShieldLearnerInfoView){.members = 1, .discount = 0.99f};
    return SHIELD_STATUS_OK;
}

static int32_t act(ShieldInstance *self, ShieldFloats observation, uint32_t mode, float *action, size_t length) {
    (void)mode; /* SHIELD_ACT_MODE_EXPLORE or SHIELD_ACT_MODE_GREEDY */
    if (!is_good(observation, self->observation_length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the observation has a wrong length or is not finite");
    }
    if (length != self->action_length) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the action has a wrong length");
    for (size_t i = 0; i < length; i++) action[i] = 0;
    return SHIELD_STATUS_OK;
}

static int32_t q_values(
    ShieldInstance *self, ShieldFloats observation, ShieldFloats action, float *values, size_t members) {
    if (members != 1 || !is_good(observation, self->observation_length) || !is_good(action, self->action_length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "a wrong length, or not finite");
    }
    values[0] = self->value;
    return SHIELD_STATUS_OK;
}

static int32_t q_gradients(ShieldInstance *self, ShieldFloats observation, ShieldFloats action, float *values,
                           size_t members, float *gradients, size_t gradients_length) {
    int32_t status = q_values(self, observation, action, values, members);
    if (status != SHIELD_STATUS_OK) return status;
    for (size_t i = 0; i < gradients_length; i++) gradients[i] = 0;
    return SHIELD_STATUS_OK;
}

static int32_t update(ShieldInstance *self, const ShieldBatchView *batch) {
    size_t size = batch->size;
    bool is_sound = is_good(batch->observations, size * self->observation_length) &&
                    is_good(batch->actions, size * self->action_length) && is_good(batch->rewards, size) &&
                    is_good(batch->next_observations, size * self->observation_length) &&
                    is_good(batch->continuations, size) && is_good(batch->masks, size);
    /* Refused as a whole: either every transition is learned, or nothing has changed. */
    if (!is_sound) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the batch has a wrong length or is not finite");
    for (size_t i = 0; i < size; i++) {
        float target = batch->rewards.pointer[i] + 0.99f * batch->continuations.pointer[i] * self->value;
        self->value += 0.1f * batch->masks.pointer[i] * (target - self->value);
    }
    return SHIELD_STATUS_OK;
}
<% endblock %>

<% block table %>
    .info = info,
    .act = act,
    .q_values = q_values,
    .q_gradients = q_gradients,
    .update = update,
<% endblock %>
