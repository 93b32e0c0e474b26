"""Whether the shield helped: the figures that matter, for a person."""

from __future__ import annotations

from typing import Any

#: Before so many steps, and so many attempts and hard resets, nothing is judged.
FEW_STEPS, FEW_RESETS = 1_000, 10
#: It helps if it needs at most this share of the hard resets without it.
HELPS = 0.5
#: The share of the steps that should be the agent's.
OWN_STEPS = 0.6
#: By how much the realised risk may exceed the accepted one.
TOLERANCE = 0.03


class Report(dict[str, Any]):
    """The figures by name; as a text, what they say. What is not known is None.

    - `steps`: of both agents, the count at which to compare with a training without the shield; `your_steps`: your agent's.
    - `episodes`, `hard_resets`: of your agent, and of the environment.
    - `hard_resets_without_shield`: about how many there would have been in as many steps, one after each episode; estimated from the time limit and from your
      agent's episodes that the shield did not cut short. `hard_resets_for_your_steps`: the same in as many steps as your agent made.
    - `early_aborts`, `projections`: actions that were not executed, and that were altered.
    - `attempts`, `attempts_succeeded`, `realised_risk`: of the reset agent; the share that failed, None before the first.
    - `recent_risk`, `accepted_risk`, `threshold`: of the rule `undo-probability`: the share that failed of the last 100, the one that may fail, and the share of the undo
      probability at the start that an action must have.
    - `irreversible_entries`: where `is_irreversible` counts them.
    - `findings`: what keeps the shield from helping, as sentences.
    - `verdict`: `helps`, `helps_little`, `does_not_help`, or `too_early`; `judgement`: the same in words, with the reason.
    """

    def __str__(self) -> str:
        resets, usual = self["hard_resets"], self["hard_resets_without_shield"]
        lines = [
            f"{self['steps']} steps, {self['your_steps']} of them your agent's ({share(self['your_steps'], self['steps'])}).",
            f"{resets} hard resets in {self['episodes']} episodes; without a shield about {usual} in as many steps.",
            f"{self['early_aborts']} actions were not executed, {self['projections']} altered.",
            f"{self['attempts_succeeded']} of {self['attempts']} attempts to reset succeeded{risk(self)}.",
        ]
        if self["irreversible_entries"] is not None:
            lines.append(f"{self['irreversible_entries']} times something happened that cannot be undone.")
        lines += self["findings"]
        if not self["findings"] and self["verdict"] in ("helps", "too_early"):
            lines.append("Nothing was found that keeps the shield from helping.")
        lines.append(f"Compare with a training without the shield at {self['steps']} steps.")
        return "\n".join([*lines, self["judgement"]])


def share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f}%" if whole else "–"


def risk(figures: Report) -> str:
    """Realised against accepted risk, and the threshold, as far as there are any."""
    realised, accepted, threshold = figures["realised_risk"], figures["accepted_risk"], figures["threshold"]
    parts = [] if realised is None else [f"{realised:.1%} failed"]
    parts += [] if accepted is None else [f"{accepted:.1%} may fail"]
    parts += [] if threshold is None else [f"the threshold is {threshold:.2f}"]
    return f" ({', '.join(parts)})" if parts else ""


def report(
    metrics: dict[str, float], findings: list[tuple[str, str]], is_resetting: bool, limit: int | None
) -> Report:
    """What a shield has counted and found so far. An attempt that is under way is not among the attempts. `limit`: the time limit of an episode."""
    count = {name: int(metrics[name]) for name in NAMES}
    attempts, succeeded = count["reset_episodes"] - int(is_resetting), count["reset_successes"]
    steps, own = count["steps"], count["forward_steps"]
    # Without a shield an aborted episode would have gone on, so that it is none of those that would have ended in a hard reset.
    whole = max(count["forward_episodes"] - count["early_aborts"], 0)
    entries = metrics.get("irreversible_entries")
    figures = Report(
        steps=steps,
        your_steps=own,
        episodes=count["forward_episodes"],
        hard_resets=count["hard_resets"],
        hard_resets_without_shield=max(round(whole * steps / own) if own else 0, steps // limit if limit else 0),
        hard_resets_for_your_steps=max(whole, own // limit if limit else 0),
        early_aborts=count["early_aborts"],
        projections=count["projections"],
        attempts=attempts,
        attempts_succeeded=succeeded,
        realised_risk=1 - succeeded / attempts if attempts else None,
        recent_risk=metrics.get("realised_risk"),
        accepted_risk=metrics.get("accepted_risk"),
        threshold=metrics.get("threshold"),
        irreversible_entries=None if entries is None else int(entries),
        findings=[sentence for _, sentence in findings],
    )
    figures["verdict"], figures["judgement"] = judgement(figures)
    return figures


def judgement(figures: Report) -> tuple[str, str]:
    """The verdict, and a sentence or two."""
    steps, resets, usual = figures["steps"], figures["hard_resets"], figures["hard_resets_without_shield"]
    if steps < FEW_STEPS or figures["attempts"] + resets < FEW_RESETS:
        least = f"{FEW_STEPS} steps and {FEW_RESETS} attempts or hard resets"
        return "too_early", f"It is too early to say whether the shield helps: that takes {least}."
    said = f"{resets} hard resets instead of about {usual}"
    for_yours = figures["hard_resets_for_your_steps"]
    if resets >= usual:
        verdict, sentences = "does_not_help", [f"The shield does not help: {said}.", reason(figures)]
    elif resets >= for_yours:
        own = f"For as many steps of your agent there would have been about {for_yours}."
        verdict, sentences = "helps_little", [f"The shield helps little: {said}.", own, reason(figures)]
    elif resets > HELPS * usual:
        verdict, sentences = "helps_little", [f"The shield helps little: {said}.", reason(figures)]
    else:
        verdict, sentences = "helps", [f"The shield helps: {said}."]
    if figures["your_steps"] < OWN_STEPS * steps:
        sentences.append(f"It costs much: only {share(figures['your_steps'], steps)} of the steps were your agent's.")
    realised, accepted = figures["realised_risk"], figures["accepted_risk"]
    if realised is not None and accepted is not None and realised > accepted + TOLERANCE:
        sentences.append(f"More attempts fail than you accept: {realised:.0%} instead of {accepted:.0%}.")
    return verdict, " ".join(sentences)


def reason(figures: Report) -> str:
    """Why hard resets are not saved, as far as the counts tell."""
    attempts = figures["attempts"]
    failed = attempts - figures["attempts_succeeded"]
    if attempts == 0:
        return "The reset agent was never in charge: every episode ended in the environment's own reset."
    if failed >= figures["hard_resets"] / 2:
        return f"{failed} of {attempts} attempts to reset failed."
    return "Most of them followed an end of the environment, or a reset() with a seed or options, and no attempt."


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
