/* {{id}}: a point on a line that falls off beyond 1. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "shield_plugin.h"

/* The state of an instance: what it is, this file alone decides. */
struct ShieldInstance {
    float position;
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
    *instance = self;
    return SHIELD_STATUS_OK;
}

static void destroy(ShieldInstance *self) { free(self); }

static int32_t save(ShieldInstance *self, const ShieldWriter *writer) {
    return writer->write(writer->context, (const uint8_t *)&self->position, sizeof self->position);
}

static int32_t load(ShieldInstance *self, const uint8_t *bytes, size_t length) {
    float saved;
    if (length != sizeof saved) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "a saved state has 4 bytes");
    memcpy(&saved, bytes, sizeof saved);
    if (!isfinite(saved)) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the saved state is not finite");
    self->position = saved;
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

SHIELD_MANIFEST(manifest, "{{id}}", "environment", "0.1.0", "{{author}}", "MIT OR Apache-2.0", "A point on a line that falls off beyond 1", "true", "");

static const ShieldEnvironmentTable table = {
    .struct_size = sizeof table,
    .life = {create, destroy, save, load, last_error, get_extension},
    .spec = spec,
    .reset = reset,
    .step = step,
};

static const ShieldPluginDescriptor plugins[] = {{
    .struct_size = sizeof plugins[0],
    .kind = SHIELD_KIND_ENVIRONMENT,
    .manifest = SHIELD_MANIFEST_TEXT(manifest),
    .environment = &table,
}};

static const ShieldPluginLibrary library = {
    .struct_size = sizeof library,
    .abi_major = SHIELD_ABI_MAJOR,
    .abi_minor = SHIELD_ABI_MINOR,
    .plugin_count = 1,
    .plugins = plugins,
};

const ShieldPluginLibrary *shield_plugin_entry_v1(void) { return &library; }
