// cpp/rate-limit: an action may not jump. Whatever C++ throws stays in here.
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include "shield_plugin.h"

struct ShieldInstance {
    float limit;
    std::string error;
};

namespace {

thread_local std::string create_error;
thread_local ShieldPositionView create_position;

// A fault of the configuration and its place, from which the host finds the place in the user's file.
struct InvalidConfig : std::runtime_error {
    InvalidConfig(const char *message, ShieldPositionView position) : std::runtime_error(message), position(position) {}
    ShieldPositionView position;
};

// The one place where an exception ends: as a status, and a message that `last_error` gives.
template <typename Body> int32_t guarded(std::string &error, Body body) noexcept {
    try {
        body();
        return SHIELD_STATUS_OK;
    } catch (const InvalidConfig &fault) {
        error = fault.what();
        create_position = fault.position;
        return SHIELD_STATUS_INVALID_CONFIG;
    } catch (const std::invalid_argument &fault) {
        error = fault.what();
        return SHIELD_STATUS_INVALID_ARGUMENT;
    } catch (const std::exception &fault) {
        error = fault.what();
        return SHIELD_STATUS_FAILED;
    } catch (...) {
        error = "something was thrown that is no std::exception";
        return SHIELD_STATUS_FAILED;
    }
}

std::vector<float> finite(ShieldFloats values, const char *what) {
    std::vector<float> copy(values.pointer, values.pointer + values.length);
    for (float value : copy) {
        if (!std::isfinite(value)) throw std::invalid_argument(std::string(what) + " is not finite");
    }
    return copy;
}

// Where the value of the only field stands: line and column, from 1.
ShieldPositionView value_position(ShieldText config) {
    ShieldPositionView position = {1, 1};
    bool is_behind_colon = false;
    for (size_t i = 0; i < config.length; i++) {
        uint8_t byte = config.pointer[i];
        if (is_behind_colon && !std::strchr(" \t\r\n", byte)) return position;
        is_behind_colon = is_behind_colon || byte == ':';
        if (byte == '\n') position = {position.line + 1, 1};
        else if ((byte & 0xC0) != 0x80) position.column++; // columns count characters, not bytes
    }
    return {1, 1};
}

// RON with one field, `(limit: 0.5)`. Anything else is refused: a misspelt field must not be overlooked.
float read_limit(ShieldText config) {
    std::string text;
    for (size_t i = 0; i < config.length; i++) {
        if (!std::strchr(" \t\r\n", config.pointer[i])) text += static_cast<char>(config.pointer[i]);
    }
    if (text.empty() || text == "()") return 0.5f;
    const std::string before = "(limit:";
    if (text.compare(0, before.size(), before) != 0) {
        throw InvalidConfig("the only field is `limit`, as in (limit: 0.5)", {1, 1});
    }
    ShieldPositionView position = value_position(config);
    char *end = nullptr;
    float limit = std::strtof(text.c_str() + before.size(), &end);
    if (*end == ',') end++;
    if (std::strcmp(end, ")") != 0) throw InvalidConfig("`limit` is not a number, or something follows it", position);
    if (!(limit > 0 && std::isfinite(limit))) throw InvalidConfig("`limit` must be above 0", position);
    return limit;
}

int32_t create(const ShieldCreateArguments *arguments, ShieldInstance **instance) {
    create_position = {0, 0}; // not known
    return guarded(create_error, [&] { *instance = new ShieldInstance{read_limit(arguments->config), ""}; });
}

void destroy(ShieldInstance *rule) { delete rule; }

// No state beyond the configuration.
int32_t save(ShieldInstance *, const ShieldWriter *) { return SHIELD_STATUS_OK; }

int32_t load(ShieldInstance *rule, const uint8_t *, size_t length) {
    return guarded(rule->error, [&] {
        if (length != 0) throw std::invalid_argument("there is no state to load");
    });
}

size_t last_error(ShieldInstance *rule, uint8_t *buffer, size_t capacity, ShieldPositionView *position) {
    const std::string &message = rule ? rule->error : create_error;
    if (position) *position = rule ? ShieldPositionView{0, 0} : create_position;
    std::memcpy(buffer, message.data(), message.size() < capacity ? message.size() : capacity);
    return message.size();
}

const void *get_extension(ShieldText) { return nullptr; }

int32_t needs(ShieldInstance *, uint32_t *needs) {
    *needs = 0;
    return SHIELD_STATUS_OK;
}

int32_t evaluate(ShieldInstance *rule, const ShieldRuleContextView *context, ShieldVerdictView *verdict) {
    return guarded(rule->error, [&] {
        std::vector<float> proposed = finite(context->proposed, "the action");
        std::vector<float> previous = finite(context->previous, "the previous action");
        float jump = 0; // after a hard reset there is no previous action, and everything is allowed
        for (size_t i = 0; i < previous.size(); i++) jump = std::fmax(jump, std::fabs(proposed.at(i) - previous[i]));
        bool is_safe = jump <= rule->limit;
        verdict->verdict = is_safe ? SHIELD_VERDICT_ALLOW : SHIELD_VERDICT_REJECT;
        verdict->score = jump;
        if (is_safe) return;
        std::string reason = "the action jumps by " + std::to_string(jump) + ", more than " + std::to_string(rule->limit);
        verdict->reason_length = std::min(reason.size(), verdict->reason_capacity);
        std::memcpy(verdict->reason, reason.data(), verdict->reason_length);
    });
}

// previous - limit <= a <= previous + limit.
int32_t linearise(
    ShieldInstance *rule, const ShieldRuleContextView *context, ShieldFloats, const ShieldRowSink *rows) {
    return guarded(rule->error, [&] {
        std::vector<float> previous = finite(context->previous, "the previous action"), row(previous.size());
        for (size_t i = 0; i < previous.size(); i++) {
            for (float sign : {1.0f, -1.0f}) {
                row[i] = sign;
                int32_t status = rows->push(rows->context, row.data(), row.size(), rule->limit + sign * previous[i]);
                if (status != SHIELD_STATUS_OK) throw std::runtime_error("the host refuses the row");
            }
            row[i] = 0;
        }
    });
}

int32_t observe(ShieldInstance *, const ShieldObservedDecisionView *) { return SHIELD_STATUS_OK; }

SHIELD_MANIFEST(manifest, "cpp/rate-limit", "abort-rule", "1.0.0", "The Leave No Trace shield authors", "MIT OR Apache-2.0",
                "An action may not jump", "true",
                SHIELD_FIELD("limit", "f32", "0.5", "By how much each dimension of an action may differ from the one before."));

const ShieldAbortRuleTable table = {
    sizeof(table), {create, destroy, save, load, last_error, get_extension}, needs, evaluate, linearise, observe};

const ShieldPluginDescriptor plugins[] = {{sizeof(ShieldPluginDescriptor), SHIELD_KIND_ABORT_RULE,
                                           SHIELD_MANIFEST_TEXT(manifest), nullptr, nullptr, nullptr, &table, nullptr}};

const ShieldPluginLibrary library = {sizeof(library), SHIELD_ABI_MAJOR, SHIELD_ABI_MINOR, 1, plugins};

} // namespace

const ShieldPluginLibrary *shield_plugin_entry_v1(void) { return &library; }
