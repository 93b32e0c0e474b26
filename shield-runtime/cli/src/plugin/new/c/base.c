/* [[ id ]]: <% block summary %><% endblock %>. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "shield_plugin.h"

/* The state of an instance: what it is, this file alone decides. */
struct ShieldInstance {
<% if keeps_lengths %>
    size_t observation_length, action_length;
<% endif %>
<% block fields %><% endblock %>
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
<% if keeps_lengths %>

/* How many numbers an observation has: the dimensions of a box, one per alternative if discrete. */
static size_t observation_length(ShieldSpaceView space) { return space.length; }

/* How many numbers an action has: the dimensions of a box, one index if discrete. */
static size_t action_length(ShieldSpaceView space) { return space.kind == SHIELD_SPACE_KIND_DISCRETE ? 1 : space.length; }
<% endif %>

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
<% if keeps_lengths %>
    self->observation_length = observation_length(arguments->observation_space);
    self->action_length = action_length(arguments->action_space);
<% endif %>
<% block create %><% endblock %>
    *instance = self;
    return SHIELD_STATUS_OK;
}

<% block destroy %>
static void destroy(ShieldInstance *self) { free(self); }
<% endblock %>

<% if saved %>
static int32_t save(ShieldInstance *self, const ShieldWriter *writer) {
    return writer->write(writer->context, (const uint8_t *)&self->[[ saved ]], sizeof self->[[ saved ]]);
}

static int32_t load(ShieldInstance *self, const uint8_t *bytes, size_t length) {
    float saved;
    if (length != sizeof saved) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "a saved state has 4 bytes");
    memcpy(&saved, bytes, sizeof saved);
    if (!isfinite(saved)) return fail(self, SHIELD_STATUS_INVALID_ARGUMENT, "the saved state is not finite");
    self->[[ saved ]] = saved;
    return SHIELD_STATUS_OK;
}
<% else %>
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
<% endif %>

static size_t last_error(ShieldInstance *self, uint8_t *buffer, size_t capacity, ShieldPositionView *position) {
    const char *message = self ? self->error : create_error;
    size_t length = strlen(message);
    if (position) *position = (ShieldPositionView){0, 0}; /* not known */
    memcpy(buffer, message, length < capacity ? length : capacity);
    return length;
}

<% block abilities %><% endblock %>

<% block extension %>
static const void *get_extension(ShieldText name) {
    (void)name;
    return NULL; /* none */
}
<% endblock %>

SHIELD_MANIFEST(manifest, "[[ id ]]", "[[ kind ]]", "0.1.0", "[[ author ]]", "MIT OR Apache-2.0", "<% block description %><% endblock %>", "true", "");

static const Shield[[ table ]]Table table = {
    .struct_size = sizeof table,
    .life = {create, destroy, save, load, last_error, get_extension},
<% block table %><% endblock %>
};

static const ShieldPluginDescriptor plugins[] = {{
    .struct_size = sizeof plugins[0],
    .kind = SHIELD_KIND_[[ constant ]],
    .manifest = SHIELD_MANIFEST_TEXT(manifest),
    .[[ place ]] = &table,
}};

static const ShieldPluginLibrary library = {
    .struct_size = sizeof library,
    .abi_major = SHIELD_ABI_MAJOR,
    .abi_minor = SHIELD_ABI_MINOR,
    .plugin_count = 1,
    .plugins = plugins,
};

const ShieldPluginLibrary *shield_plugin_entry_v1(void) { return &library; }
