/* c/tank: a kettle that must not boil dry. Heat it to just below boiling; once the water is gone, it does not come back.
 *
 * Observation: temperature in [0, 1] (1 boils), water level in [0, 1]. Action: heater in [-1, 1], below 0 cools.
 */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "shield_plugin.h"

struct ShieldInstance {
    float temperature, level;
    char error[160];
};

static _Thread_local char create_error[160];
static const float start_temperature = 0.2f;

static int32_t fail(ShieldInstance *tank, int32_t status, const char *message) {
    snprintf(tank->error, sizeof tank->error, "%s", message);
    return status;
}

static bool is_named(ShieldText text, const char *name) {
    return text.length == strlen(name) && memcmp(text.pointer, name, text.length) == 0;
}

static int32_t create(const ShieldCreateArguments *arguments, ShieldInstance **instance) {
    bool is_empty = arguments->config.length == 0 || is_named(arguments->config, "()");
    if (!is_empty) {
        snprintf(create_error, sizeof create_error, "the tank has no settings: write config: ()");
        return SHIELD_STATUS_INVALID_CONFIG;
    }
    *instance = calloc(1, sizeof **instance);
    if (!*instance) {
        snprintf(create_error, sizeof create_error, "no memory");
        return SHIELD_STATUS_FAILED;
    }
    **instance = (ShieldInstance){.temperature = start_temperature, .level = 1};
    return SHIELD_STATUS_OK;
}

static void destroy(ShieldInstance *tank) { free(tank); }

static int32_t save(ShieldInstance *tank, const ShieldWriter *writer) {
    const float state[2] = {tank->temperature, tank->level};
    return writer->write(writer->context, (const uint8_t *)state, sizeof state);
}

static int32_t load(ShieldInstance *tank, const uint8_t *bytes, size_t length) {
    float state[2];
    if (length != sizeof state) return fail(tank, SHIELD_STATUS_INVALID_ARGUMENT, "a saved tank has 8 bytes");
    memcpy(state, bytes, sizeof state);
    for (int i = 0; i < 2; i++) {
        bool can_be = state[i] >= 0 && state[i] <= 1; /* NaN cannot */
        if (!can_be) return fail(tank, SHIELD_STATUS_INVALID_ARGUMENT, "the bytes are no saved tank");
    }
    tank->temperature = state[0];
    tank->level = state[1];
    return SHIELD_STATUS_OK;
}

static size_t last_error(ShieldInstance *tank, uint8_t *buffer, size_t capacity, ShieldPositionView *position) {
    const char *message = tank ? tank->error : create_error;
    size_t length = strlen(message);
    if (position) *position = (ShieldPositionView){0, 0};
    memcpy(buffer, message, length < capacity ? length : capacity);
    return length;
}

static int32_t spec(ShieldInstance *tank, ShieldSpecView *spec) {
    static const float low[2] = {0, 0}, high[2] = {1, 1}, cool = -1, heat = 1;
    (void)tank;
    spec->observation_space = (ShieldSpaceView){SHIELD_SPACE_KIND_BOX, 2, low, high};
    spec->action_space = (ShieldSpaceView){SHIELD_SPACE_KIND_BOX, 1, &cool, &heat};
    spec->episode_length = 100;
    spec->brings_reset_reward = 1;
    return SHIELD_STATUS_OK;
}

static int32_t start_at(ShieldInstance *tank, float temperature, float *observation, size_t length) {
    if (length != 2) return fail(tank, SHIELD_STATUS_INVALID_ARGUMENT, "an observation has two numbers");
    observation[0] = tank->temperature = temperature;
    observation[1] = tank->level = 1;
    return SHIELD_STATUS_OK;
}

static int32_t reset(ShieldInstance *tank, uint64_t seed, float *observation, size_t length) {
    float spread = (float)(seed % 1000) / 1000 - 0.5f; /* the same seed, the same start */
    return start_at(tank, start_temperature + 0.1f * spread, observation, length);
}

static int32_t step(
    ShieldInstance *tank, ShieldFloats action, float *observation, size_t length, ShieldStepView *outcome) {
    if (length != 2) return fail(tank, SHIELD_STATUS_INVALID_ARGUMENT, "an observation has two numbers");
    bool is_good = action.length == 1 && isfinite(action.pointer[0]);
    if (!is_good) return fail(tank, SHIELD_STATUS_INVALID_ARGUMENT, "an action is one finite number");
    float heater = fminf(fmaxf(action.pointer[0], -1), 1);
    tank->temperature = fminf(fmaxf(tank->temperature + 0.05f * heater, 0), 1);
    bool boils = tank->temperature >= 1;
    if (boils) tank->level = fmaxf(tank->level - 0.25f, 0);
    bool is_dry = tank->level <= 0;
    float from_start = fabsf(tank->temperature - start_temperature);
    observation[0] = tank->temperature;
    observation[1] = tank->level;
    outcome->forward_reward = is_dry ? 0 : tank->temperature;
    outcome->reset_reward = is_dry ? 0 : 1 - from_start;
    outcome->flags = (!is_dry && from_start < 0.15f ? SHIELD_STEP_FLAG_IN_RESET_SET : 0) |
                     (!is_dry && tank->temperature > 0.9f ? SHIELD_STEP_FLAG_SUCCESS : 0) |
                     (is_dry ? SHIELD_STEP_FLAG_IRREVERSIBLE : 0);
    return SHIELD_STATUS_OK;
}

/* An ability beyond the table, found by its name: initial states that an experiment can ask for. */
static size_t start_name(ShieldInstance *tank, size_t index, uint8_t *buffer, size_t capacity) {
    static const char name[] = "hot";
    (void)tank;
    if (index > 0) return 0;
    size_t length = sizeof name - 1;
    memcpy(buffer, name, length < capacity ? length : capacity);
    return length;
}

static int32_t reset_to(ShieldInstance *tank, ShieldText start, uint64_t seed, float *observation, size_t length) {
    (void)seed;
    if (!is_named(start, "hot")) return fail(tank, SHIELD_STATUS_INVALID_ARGUMENT, "the only named start is hot");
    return start_at(tank, 0.9f, observation, length);
}

static const void *get_extension(ShieldText name) {
    static const ShieldStartsTable starts = {sizeof starts, start_name, reset_to};
    return is_named(name, SHIELD_EXTENSION_STARTS) ? &starts : NULL;
}

SHIELD_MANIFEST(manifest, "c/tank", "environment", "1.0.0", "The Leave No Trace shield authors", "MIT OR Apache-2.0",
                "A kettle that must not boil dry", "true", "");

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

static const ShieldPluginLibrary library = {sizeof library, SHIELD_ABI_MAJOR, SHIELD_ABI_MINOR, 1, plugins};

const ShieldPluginLibrary *shield_plugin_entry_v1(void) { return &library; }
