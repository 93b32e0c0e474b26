"""Whether the shield helped: the figures that matter, for a person."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._shield import Shield


class Report(dict[str, Any]):
    """The figures by name; as a text, what they say.

    - `steps`: of both agents, the count at which to compare with a training without the shield; `your_steps`: your agent's.
    - `episodes`, `hard_resets`: of your agent, and of the environment. Without a shield there is one after each episode.
    - `early_aborts`, `projections`: actions that were not executed, and that were altered.
    - `attempts`, `attempts_succeeded`, `realised_risk`: of the reset agent; the share that failed, None before the first.
    - `irreversible_entries`: where `is_irreversible` counts them, else None.
    - `findings`: what keeps the shield from helping, as sentences.
    """

    def __str__(self) -> str:
        lines = [
            f"{self['steps']} steps, {self['your_steps']} of them your agent's ({share(self['your_steps'], self['steps'])}).",
            f"{self['hard_resets']} hard resets in {self['episodes']} episodes; without a shield there is one after each.",
            f"{self['early_aborts']} actions were not executed, {self['projections']} altered.",
            f"{self['attempts_succeeded']} of {self['attempts']} attempts to reset succeeded.",
        ]
        if self["irreversible_entries"] is not None:
            lines.append(f"{self['irreversible_entries']} times something happened that cannot be undone.")
        lines += self["findings"] or ["Nothing was found that keeps the shield from helping."]
        lines.append(f"Compare with a training without the shield at {self['steps']} steps.")
        return "\n".join(lines)


def share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f}%" if whole else "–"


def report(shield: Shield, irreversible_entries: int | None) -> Report:
    """What the shield has counted and found so far. An attempt that is under way is not among the attempts."""
    metrics = shield.metrics()
    count = {name: int(metrics[name]) for name in NAMES}
    attempts, succeeded = count["reset_episodes"] - int(shield.resetting), count["reset_successes"]
    return Report(
        steps=count["steps"],
        your_steps=count["forward_steps"],
        episodes=count["forward_episodes"],
        hard_resets=count["hard_resets"],
        early_aborts=count["early_aborts"],
        projections=count["projections"],
        attempts=attempts,
        attempts_succeeded=succeeded,
        realised_risk=1 - succeeded / attempts if attempts else None,
        irreversible_entries=irreversible_entries,
        findings=[sentence for _, sentence in shield.findings()],
    )


NAMES = (
    "steps",
    "forward_steps",
    "forward_episodes",
    "hard_resets",
    "early_aborts",
    "projections",
    "reset_episodes",
    "reset_successes",
)
