/* {{id}}: the same value everywhere; put a real learner here. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "shield_plugin.h"

/* The state of an instance: what it is, this file alone decides. */
struct ShieldInstance {
    size_t observation_length, action_length;
    float value;
    char error[200];
};

/* An instance that was not made cannot keep its message. */
static _Thread_local char create_error[200];

static int32_t fail(ShieldInstance *self, int32_t status, const char *message) {
    snprintf(self->error, sizeof self->error, "%s", message);
    return status;
}

/* Whether there are `length` finite numbers: NaN must be refused, never computed with. */
static bool is_good(ShieldFloats values, size_t length) {
    if (values.length != length) return false;
    for (size_t i = 0; i < length; i++) {
        if (!isfinite(values.pointer[i])) return false;
    }
    return true;
}

/* The configuration is RON text. This plugin has no fields, so that only `()` is right; a field that is not known must be refused. */
static bool is_empty_config(ShieldText config) {
    char kept[3] = "";
    size_t count = 0;
    for (size_t i = 0; i < config.length; i++) {
        if (strchr(" \t\r\n", config.pointer[i]) && config.pointer[i]) continue;
        if (count == 2) return false;
        kept[count++] = (char)config.pointer[i];
    }
    return count == 0 || strcmp(kept, "()") == 0;
}

/* How many numbers an observation has: the dimensions of a box, one per alternative if discrete. */
static size_t observation_length(ShieldSpaceView space) { return space.length; }

/* How many numbers an action has: the dimensions of a box, one index if discrete. */
static size_t action_length(ShieldSpaceView space) { return space.kind == SHIELD_SPACE_KIND_DISCRETE ? 1 : space.length; }

static int32_t create(const ShieldCreateArguments *arguments, ShieldInstance **instance) {
    if (!is_empty_config(arguments->config)) {
        snprintf(create_error, sizeof create_error, "this plugin has no settings: write config: ()");
        return SHIELD_STATUS_INVALID_CONFIG;
    }
    ShieldInstance *self = calloc(1, sizeof *self);
    if (!self) {
        snprintf(create_error, sizeof create_error, "no memory");
        return SHIELD_STATUS_FAILED;
    }
    self->observation_length = observation_length(arguments->observation_space);
    self->action_length = action_length(arguments->action_space);
    *instance = self;
    return SHIELD_STATUS_OK;
}

static void destroy(ShieldInstance *self) { free(self); }

static int32_t save(ShieldInstance *self, const ShieldWriter *writer) {
    return writer->write(writer->context, (const uint8_t *)&self->value, sizeof self->value);
}

static int32_t load(ShieldInstance *self, const uint8_t *bytes, size_t length) {
    float saved;
    if (length != sizeof saved) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "a saved state has 4 bytes");
    memcpy(&saved, bytes, sizeof saved);
    if (!isfinite(saved)) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the saved state is not finite");
    self->value = saved;
    return SHIELD_STATUS_OK;
}

static size_t last_error(ShieldInstance *self, uint8_t *buffer, size_t capacity, ShieldPositionView *position) {
    const char *message = self ? self->error : create_error;
    size_t length = strlen(message);
    if (position) *position = (ShieldPositionView){0, 0}; /* not known */
    memcpy(buffer, message, length < capacity ? length : capacity);
    return length;
}

static const void *get_extension(ShieldText name) {
    (void)name;
    return NULL; /* none */
}

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

SHIELD_MANIFEST(manifest, "{{id}}", "learner", "0.1.0", "{{author}}", "MIT OR Apache-2.0", "The same value everywhere", "true", "");

static const ShieldLearnerTable table = {
    .struct_size = sizeof table,
    .life = {create, destroy, save, load, last_error, get_extension},
    .info = info,
    .act = act,
    .q_values = q_values,
    .q_gradients = q_gradients,
    .update = update,
};

static const ShieldPluginDescriptor plugins[] = {{
    .struct_size = sizeof plugins[0],
    .kind = SHIELD_KIND_LEARNER,
    .manifest = SHIELD_MANIFEST_TEXT(manifest),
    .learner = &table,
}};

static const ShieldPluginLibrary library = {
    .struct_size = sizeof library,
    .abi_major = SHIELD_ABI_MAJOR,
    .abi_minor = SHIELD_ABI_MINOR,
    .plugin_count = 1,
    .plugins = plugins,
};

const ShieldPluginLibrary *shield_plugin_entry_v1(void) { return &library; }
