<% extends "c/base.c" %>
<% set keeps_lengths = true %>
<% block summary %>reset means that the first number of the observation is small<% endblock %>
<% block description %>Reset is where the first number of the observation is small<% endblock %>

<% block abilities %>
static int32_t evaluate(ShieldInstance *self, ShieldFloats observation, ShieldFloats action, ShieldFloats next_observation,
                        ShieldResetSignalView *signal) {
    if (!is_good(observation, self->observation_length) || !is_good(action, self->action_length) ||
        !is_good(next_observation, self->observation_length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "a wrong length, or not finite");
    }
    float distance = fabsf(next_observation.pointer[0]);
    signal->reward = fmaxf(1 - distance, 0);
    signal->in_reset_set = distance < 0.1f;
    return SHIELD_STATUS_OK;
}

static int32_t observe_start(ShieldInstance *self, ShieldFloats observation) {
    if (!is_good(observation, self->observation_length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the observation has a wrong length or is not finite");
    }
    return SHIELD_STATUS_OK; /* a task may learn here what a start looks like */
}
<% endblock %>

<% block table %>
    .evaluate = evaluate,
    .observe_start = observe_start,
<% endblock %>
