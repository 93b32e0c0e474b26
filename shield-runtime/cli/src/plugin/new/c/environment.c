<% extends "c/base.c" %>
<% set saved = "position" %>
<% block summary %>a point on a line that falls off beyond 1<% endblock %>
<% block description %>A point on a line that falls off beyond 1<% endblock %>

<% block fields %>
    float position;
<% endblock %>

<% block abilities %>
static int32_t spec(ShieldInstance *self, ShieldSpecView *spec) {
    static const float observation_low = -INFINITY, observation_high = INFINITY, action_low = -1, action_high = 1;
    (void)self;
    spec->observation_space = (ShieldSpaceView){SHIELD_SPACE_KIND_BOX, 1, &observation_low, &observation_high};
    spec->action_space = (ShieldSpaceView){SHIELD_SPACE_KIND_BOX, 1, &action_low, &action_high};
    spec->episode_length = 50;
    spec->brings_reset_reward = 1;
    return SHIELD_STATUS_OK;
}

static int32_t reset(ShieldInstance *self, uint64_t seed, float *observation, size_t length) {
    (void)seed; /* every episode begins at the same place */
    if (length != 1) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "an observation is one number");
    self->position = observation[0] = 0;
    return SHIELD_STATUS_OK;
}

static int32_t step(
    ShieldInstance *self, ShieldFloats action, float *observation, size_t length, ShieldStepView *outcome) {
    if (length != 1) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "an observation is one number");
    if (!is_good(action, 1)) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "an action is one finite number");
    bool has_fallen = self->position > 1;
    if (!has_fallen) self->position += 0.1f * fminf(fmaxf(action.pointer[0], -1), 1);
    float distance = fabsf(self->position);
    observation[0] = self->position;
    outcome->forward_reward = fminf(fmaxf(self->position, 0), 1);
    outcome->reset_reward = 1 - fminf(distance, 1);
    outcome->flags = (distance < 0.1f ? SHIELD_STEP_FLAG_IN_RESET_SET : 0) |
                     (self->position > 0.9f ? SHIELD_STEP_FLAG_SUCCESS : 0) |
                     (self->position > 1 ? SHIELD_STEP_FLAG_IRREVERSIBLE : 0);
    return SHIELD_STATUS_OK;
}
<% endblock %>

<% block table %>
    .spec = spec,
    .reset = reset,
    .step = step,
<% endblock %>
