#ifdef __cplusplus
extern "C" {
#endif
#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
// The one function that a library exports: its list of plugins.
const ShieldPluginLibrary *shield_plugin_entry_v1(void);
#ifdef __cplusplus
}
#endif

#define SHIELD_STRING_OF(value) #value
#define SHIELD_STRING(value) SHIELD_STRING_OF(value)

// One field of the configuration: four string literals.
#define SHIELD_FIELD(name, type, default_value, doc) \
    "field=" name "\x1f" "type=" type "\x1f" "default=" default_value "\x1f" "doc=" doc "\x1f"

// Places the manifest of one plugin into the section of the file that is read without loading it, as a constant named
// `variable`. All arguments but the first are string literals: `kind` is "environment", "learner", "policy", "abort-rule",
// "reset-task" or "success-critic"; `deterministic` is "true" or "false"; `fields` is a sequence of SHIELD_FIELD(...), or "".
#define SHIELD_MANIFEST(variable, id, kind, version, authors, license, description, deterministic, fields) \
    __attribute__((section(".shield_manifest"), used)) static const char variable[] = \
        "SHIELD MANIFEST 1\x1f" "id=" id "\x1f" "kind=" kind "\x1f" "version=" version "\x1f" \
        "abi=" SHIELD_STRING(SHIELD_ABI_MAJOR) "." SHIELD_STRING(SHIELD_ABI_MINOR) "\x1f" \
        "language=c\x1f" "panic=unwind\x1f" "authors=" authors "\x1f" "license=" license "\x1f" \
        "description=" description "\x1f" "deterministic=" deterministic "\x1f" fields "\x1e"

// The same text, as a descriptor wants it.
#define SHIELD_MANIFEST_TEXT(variable) { (const uint8_t *)(variable), sizeof(variable) - 1 }

#endif  /* SHIELD_PLUGIN_H */
