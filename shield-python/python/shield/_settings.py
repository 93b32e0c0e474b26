"""Keyword arguments as overrides of the configuration, which is RON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Keyword arguments, and the fields that they stand for.
PATHS = {
    "warm_up_steps": "shield.warm_up_steps",
    "reset_attempts": "shield.reset_attempts",
    "episode_length": "episode_length",
    "updates_per_step": "experience.updates_per_step",
    "seed": "seed",
    "threads": "threads",
}


#: Where the schedule of Q_min stands.
SCHEDULE = "shield.rules[0].config.schedule"


def overrides(settings: Mapping[str, Any], further: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Path, RON value, and what the user wrote. An argument that is None was not given."""
    given = [(PATHS[name], ron(value), name, value) for name, value in settings.items() if value is not None]
    given += [(path, ron(value), f"overrides[{path!r}]", value) for path, value in further.items()]
    return [(path, value, f"{name}={written!r}") for path, value, name, written in given]


def override_of_q_min(q_min: float, schedule: str | None) -> tuple[str, str, str]:
    """The same for `q_min`. Where Q_min has a schedule, as in the usual configuration, `q_min` is where it ends."""
    has_schedule = schedule is not None and schedule != "Constant"
    field, value = ("final_q_min", f"Some({ron(q_min)})") if has_schedule else ("q_min", ron(q_min))
    return f"shield.rules[0].config.{field}", value, f"q_min={q_min!r}"


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
