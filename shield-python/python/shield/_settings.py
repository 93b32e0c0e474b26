"""Keyword arguments as overrides of the configuration, which is RON."""

from __future__ import annotations

import difflib
import numbers
import os
from collections.abc import Callable, Mapping
from typing import Any, TypedDict

from ._core import USUAL_RISK, ConfigError


class Settings(TypedDict, total=False):
    """The keyword arguments of `Shield`, which explains each, and of `ShieldedEnv`. One that is None was not given."""

    reset_reward: Callable[[Any], float] | None
    in_reset_set: Callable[[Any], bool] | None
    reset_policy: Callable[[Any], Any] | None
    config: str | os.PathLike[str] | None
    tensorboard: str | os.PathLike[str] | None
    record: str | os.PathLike[str] | None
    record_every: int | None
    record_limit: int | None
    accepted_risk: float | None
    q_min: float | None
    warm_up_steps: int | None
    reset_attempts: int | str | None
    attempt_length: int | str | None
    episode_length: int | None
    calibration_resets: int | None
    updates_per_step: int | None
    update_every: int | None
    seed: int | None
    threads: int | None
    overrides: Mapping[str, Any] | None


# Those that stand for a field of the configuration, and where it is.
PATHS = {
    "warm_up_steps": "shield.warm_up_steps",
    "reset_attempts": "shield.reset_attempts",
    "attempt_length": "shield.attempt_length",
    "episode_length": "episode_length",
    "calibration_resets": "calibration_resets",
    "updates_per_step": "experience.updates_per_step",
    "update_every": "experience.update_every",
    "seed": "seed",
    "threads": "threads",
}


#: The plugin of the first rule, and where the schedule of its Q_min stands.
FIRST_RULE = "shield.rules[0].plugin"
SCHEDULE = "shield.rules[0].config.schedule"

#: The rule that has an accepted risk.
UNDO_PROBABILITY = "undo-probability"


def refuse_unknown(settings: Settings) -> None:
    """Raises TypeError for an argument that does not exist, with the name that was meant."""
    for name in settings.keys() - Settings.__annotations__.keys():
        near = difflib.get_close_matches(name, Settings.__annotations__, 1)
        raise TypeError(f"there is no argument {name!r}" + (f"; did you mean {near[0]!r}?" if near else ""))


def overrides(settings: Settings) -> list[tuple[str, str, str]]:
    """Path, RON value, and what the user wrote."""
    further = settings.get("overrides") or {}
    named = [(name, settings.get(name)) for name in PATHS]
    given = [(PATHS[name], in_ron(name, value), name, value) for name, value in named if value is not None]
    given += [(path, ron(value), f"overrides[{path!r}]", value) for path, value in further.items()]
    return [(path, value, f"{name}={written!r}") for path, value, name, written in given]


def overrides_of_first_rule(
    settings: Settings, written_at: Callable[[str], str | None]
) -> list[tuple[str, str, str]]:
    """The same for `accepted_risk` and `q_min`, which are settings of the first rule. `written_at` gives the RON text at a path."""
    accepted_risk, q_min = settings.get("accepted_risk"), settings.get("q_min")
    if accepted_risk is None and q_min is None:
        return []
    plugin = (written_at(FIRST_RULE) or "").strip().strip('"')
    first = f"the first rule is {plugin!r}" if plugin else "the first rule is composed of others"
    sets = []
    if accepted_risk is not None:
        if plugin != UNDO_PROBABILITY:
            remedy = f"q_min= is for a rule with a threshold of its own; {UNDO_PROBABILITY!r} is the rule with an accepted risk"
            raise ConfigError(f"accepted_risk={accepted_risk!r}: {first}, which has none; {remedy}")
        sets.append(("shield.rules[0].config.accepted_risk", f"Some({ron(accepted_risk)})", f"{accepted_risk=}"))
    if q_min is not None:
        if plugin == UNDO_PROBABILITY:
            remedy = "give accepted_risk=, the share of attempts that may fail, or another rule in `config` or `overrides`"
            raise ConfigError(f"q_min={q_min!r}: {first}, which compares probabilities and has no q_min; {remedy}")
        sets.append(override_of_q_min(q_min, written_at(SCHEDULE)))
    return sets


def accepted_risk_of(written_at: Callable[[str], str | None]) -> tuple[float | None, float | None]:
    """The accepted risk of the first rule, and its budget of hard resets per 1,000 steps; None where it has none."""

    def number(field: str) -> float | None:
        text = (written_at(f"shield.rules[0].config.{field}") or "None").strip()
        text = text.removeprefix("Some(").removesuffix(")")
        return None if text == "None" else float(text)

    is_adapting = (written_at("shield.rules[0].config.adapt") or "true").strip() == "true"
    if (written_at(FIRST_RULE) or "").strip().strip('"') != UNDO_PROBABILITY or not is_adapting:
        return None, None
    try:
        accepted_risk, budget = number("accepted_risk"), number("hard_resets_per_1000")
    except ValueError:
        # Written in another way than this can read, such as with a comment in it.
        return None, None
    return (USUAL_RISK if accepted_risk is None and budget is None else accepted_risk), budget


def override_of_q_min(q_min: float, schedule: str | None) -> tuple[str, str, str]:
    """The same for `q_min`. Where Q_min has a schedule, `q_min` is where it ends."""
    has_schedule = schedule is not None and schedule != "Constant"
    field, value = ("final_q_min", f"Some({ron(q_min)})") if has_schedule else ("q_min", ron(q_min))
    return f"shield.rules[0].config.{field}", value, f"q_min={q_min!r}"


def in_ron(name: str, value: Any) -> str:
    """The value of an argument as RON. A number of steps is one of several ways to say how long an attempt may be."""
    is_number = name == "attempt_length" and not isinstance(value, str)
    return f"Steps({ron(value)})" if is_number else ron(value)


def recorded(settings: Settings) -> tuple[str | os.PathLike[str], int | None, int | None] | None:
    """The folder of the record, how often decisions are recorded, and how many at most; None without a record."""
    folder, amounts = settings.get("record"), []
    for name in ("record_every", "record_limit"):
        given = settings.get(name)
        if given is not None:
            if isinstance(given, bool) or not isinstance(given, numbers.Integral) or not 1 <= given < 2**63:
                raise ConfigError(f"{name}={given!r}: it is a whole number, 1 or more")
            if folder is None:
                raise ConfigError(f"{name}={given!r}: nothing is recorded; name a folder, record=\"…\"")
        amounts.append(None if given is None else int(given))
    return None if folder is None else (folder, amounts[0], amounts[1])


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
