/* {{id}}: forbids pushing hard. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "shield_plugin.h"

/* The state of an instance: what it is, this file alone decides. */
struct ShieldInstance {
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

/* There is no state beyond the configuration: nothing to save, and nothing to load. */
static int32_t save(ShieldInstance *self, const ShieldWriter *writer) {
    (void)self;
    (void)writer;
    return SHIELD_STATUS_OK;
}

static int32_t load(ShieldInstance *self, const uint8_t *bytes, size_t length) {
    (void)bytes;
    if (length != 0) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "there is no state to load");
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

static const float limit = 0.9f;

static int32_t needs(ShieldInstance *self, uint32_t *needs) {
    (void)self;
    *needs = 0; /* SHIELD_NEED_VALUES asks for the reset ensemble's values of the proposed action */
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
    (void)decision; /* the only place where a rule may change its state */
    return SHIELD_STATUS_OK;
}

SHIELD_MANIFEST(manifest, "{{id}}", "abort-rule", "0.1.0", "{{author}}", "MIT OR Apache-2.0", "Forbids pushing hard", "true", "");

static const ShieldAbortRuleTable table = {
    .struct_size = sizeof table,
    .life = {create, destroy, save, load, last_error, get_extension},
    .needs = needs,
    .evaluate = evaluate,
    .linearise = linearise,
    .observe = observe,
};

static const ShieldPluginDescriptor plugins[] = {{
    .struct_size = sizeof plugins[0],
    .kind = SHIELD_KIND_ABORT_RULE,
    .manifest = SHIELD_MANIFEST_TEXT(manifest),
    .abort_rule = &table,
}};

static const ShieldPluginLibrary library = {
    .struct_size = sizeof library,
    .abi_major = SHIELD_ABI_MAJOR,
    .abi_minor = SHIELD_ABI_MINOR,
    .plugin_count = 1,
    .plugins = plugins,
};

const ShieldPluginLibrary *shield_plugin_entry_v1(void) { return &library; }
