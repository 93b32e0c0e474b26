"""Keyword arguments as overrides of the configuration, which is RON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Keyword arguments, and the fields that they stand for.
PATHS = {
    "q_min": "shield.rules[0].config.q_min",
    "warm_up_steps": "shield.warm_up_steps",
    "reset_attempts": "shield.reset_attempts",
    "episode_length": "episode_length",
    "updates_per_step": "experience.updates_per_step",
    "seed": "seed",
    "threads": "threads",
}


def overrides(settings: Mapping[str, Any], further: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Path, RON value, and what the user wrote. An argument that is None was not given."""
    given = [(PATHS[name], name, value) for name, value in settings.items() if value is not None]
    given += [(path, f"overrides[{path!r}]", value) for path, value in further.items()]
    return [(path, ron(value), f"{name}={value!r}") for path, name, value in given]


def ron(value: Any) -> str:
    """A Python value as RON. A string is RON already, as after `--set` on the command line."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "None"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(ron, value))}]"
    return repr(value.item() if hasattr(value, "item") else value)
