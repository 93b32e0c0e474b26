<% extends "c/base.c" %>
<% set keeps_lengths = true %>
<% block summary %>the middle of the action space; put a controller here<% endblock %>
<% block description %>Always the middle of the action space<% endblock %>

<% block fields %>
    float *middle;
<% endblock %>

<% block create %>
    self->middle = calloc(self->action_length, sizeof *self->middle);
    if (!self->middle) {
        free(self);
        snprintf(create_error, sizeof create_error, "no memory");
        return SHIELD_STATUS_FAILED;
    }
    if (arguments->action_space.kind == SHIELD_SPACE_KIND_BOX) {
        const float *low = arguments->action_space.low, *high = arguments->action_space.high;
        for (size_t i = 0; i < self->action_length; i++) self->middle[i] = (low[i] + high[i]) / 2;
    }
<% endblock %>

<% block destroy %>
static void destroy(ShieldInstance *self) {
    if (self) free(self->middle);
    free(self);
}
<% endblock %>

<% block abilities %>
static int32_t act(ShieldInstance *self, ShieldFloats observation, float *action, size_t length) {
    if (!is_good(observation, self->observation_length)) {
        return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the observation has a wrong length or is not finite");
    }
    if (length != self->action_length) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the action has a wrong length");
    memcpy(action, self->middle, length * sizeof *action);
    return SHIELD_STATUS_OK;
}
<% endblock %>

<% block table %>
    .act = act,
<% endblock %>
