"""What a shield has done so far, and whether it helps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

#: Before so many steps, and so many attempts to reset, nothing is judged.
FEW_STEPS, FEW_ATTEMPTS = 1_000, 10
#: It helps if it needs at most this share of the hard resets without it.
HELPS = 0.5
#: The share of steps that should be the agent's own.
OWN_STEPS = 0.6
#: By how much the realised risk may exceed the accepted one.
TOLERANCE = 0.03


def figures_of(
    metrics: dict[str, float],
    accepted_risk: float | None,
    budget: float | None,
    limit: int | None,
    findings: Sequence[tuple[str, str]] = (),
) -> dict[str, Any]:
    """The figures that matter, from the counts of a shield. `budget`: accepted hard resets per 1,000 steps; `limit`: the time limit of an episode.

    `hard_resets_without_shield`: about how many there would be in as many steps, one after each episode, as far as the time limit and the agent's episodes that the
    shield did not cut short tell; `hard_resets_for_forward_steps`: the same in as many steps as the agent made.
    """
    count = {name: int(value) for name, value in metrics.items() if value.is_integer()}
    steps, own = count["steps"], count["forward_steps"]
    attempts, successes = count["reset_episodes"], count["reset_successes"]
    # An aborted episode would have gone on without a shield, so that it is no episode of the status quo.
    whole = max(count["forward_episodes"] - count["early_aborts"], 0)
    status_quo = max(round(whole * steps / own) if own else 0, steps // limit if limit else 0)
    figures: dict[str, Any] = {
        "steps": steps,
        "forward_steps": count["forward_steps"],
        "forward_share": count["forward_steps"] / steps if steps else None,
        "episodes": count["forward_episodes"],
        "hard_resets": count["hard_resets"],
        "hard_resets_without_shield": status_quo,
        "hard_resets_for_forward_steps": max(whole, own // limit if limit else 0),
        "aborts": count["early_aborts"],
        "projections": count["projections"],
        "attempts": attempts,
        "reset_successes": successes,
        "realised_risk": 1.0 - successes / attempts if attempts else None,
        "recent_realised_risk": metrics.get("realised_risk"),
        "accepted_risk": accepted_risk,
        "accepted_hard_resets_per_1000": budget,
        "threshold": metrics.get("threshold"),
        "irreversible_entries": count.get("irreversible_entries"),
        "findings": [sentence for _, sentence in findings],
    }
    figures["verdict"], figures["judgement"] = judgement(figures)
    return figures


def judgement(figures: dict[str, Any]) -> tuple[str, str]:
    """`helps`, `helps_little`, `does_not_help` or `too_early`; and a sentence."""
    steps, resets, usual = figures["steps"], figures["hard_resets"], figures["hard_resets_without_shield"]
    if steps < FEW_STEPS or figures["attempts"] + resets < FEW_ATTEMPTS:
        few = f"{FEW_STEPS:,} steps and {FEW_ATTEMPTS} attempts or hard resets"
        return "too_early", f"It is too early to say whether the shield helps: that takes {few}."
    said = f"{resets:,} hard resets instead of about {usual:,}"
    for_own = figures["hard_resets_for_forward_steps"]
    if resets >= usual:
        verdict, sentence = "does_not_help", f"The shield does not help: {said}. {reason_of(figures)}"
    elif resets >= for_own:
        own = f"For as many steps of your agent there would have been about {for_own:,}."
        verdict, sentence = "helps_little", f"The shield helps little: {said}. {own} {reason_of(figures)}"
    elif resets > HELPS * usual:
        verdict, sentence = "helps_little", f"The shield helps little: {said}. {reason_of(figures)}"
    else:
        verdict, sentence = "helps", f"The shield saves hard resets: {said}."
    further = []
    if figures["forward_share"] < OWN_STEPS:
        further.append(f"It costs much: only {figures['forward_share']:.0%} of the steps were your agent's.")
    if exceeds_risk(figures):
        risk = f"{figures['realised_risk']:.0%} of the attempts failed, and {figures['accepted_risk']:.0%} are accepted"
        further.append(f"More attempts fail than you accept: {risk}.")
    return verdict, " ".join([sentence.strip(), *further])


def reason_of(figures: dict[str, Any]) -> str:
    """Why hard resets are not saved, as far as the counts tell."""
    attempts, successes = figures["attempts"], figures["reset_successes"]
    failed = attempts - successes
    if attempts == 0:
        return "The reset agent was never in charge: each episode ended in a hard reset (the environment ended, or reset() was given a seed or options)."
    if failed >= figures["hard_resets"] / 2:
        return f"{failed:,} of {attempts:,} attempts to get back failed."
    return "Most of them followed an end of the environment, or a reset() with a seed or options, where the reset agent is not asked."


def exceeds_risk(figures: dict[str, Any]) -> bool:
    accepted, realised = figures["accepted_risk"], figures["realised_risk"]
    return accepted is not None and realised is not None and realised > accepted + TOLERANCE


def text_of(figures: dict[str, Any]) -> str:
    """The same for a person."""
    share = "" if figures["forward_share"] is None else f" ({figures['forward_share']:.0%})"
    lines = [
        ("steps", f"{figures['steps']:,}, of them your agent's {figures['forward_steps']:,}{share}"),
        ("", f"(compare with a training without the shield at {figures['steps']:,} steps)"),
        ("episodes", f"{figures['episodes']:,}"),
        ("hard resets", f"{figures['hard_resets']:,}; without the shield about {figures['hard_resets_without_shield']:,} in as many steps"),
        ("aborts", f"{figures['aborts']:,}; actions altered instead: {figures['projections']:,}"),
        ("attempts", attempts_line(figures)),
    ]
    if figures["accepted_risk"] is not None or figures["accepted_hard_resets_per_1000"] is not None:
        lines.append(("risk", risk_line(figures)))
    if figures["threshold"] is not None:
        lines.append(("threshold", f"{figures['threshold']:.2f}, a share of the undo probability at the start"))
    if figures["irreversible_entries"] is not None:
        lines.append(("irreversible", f"{figures['irreversible_entries']:,} entries"))
    lines += [("found", sentence) for sentence in figures["findings"]]
    return "\n".join([*(f"{name:<13}{text}" for name, text in lines), figures["judgement"]])


def attempts_line(figures: dict[str, Any]) -> str:
    attempts, successes = figures["attempts"], figures["reset_successes"]
    share = f" ({successes / attempts:.0%})" if attempts else ""
    return f"{attempts:,} of the reset agent, of them back at the start {successes:,}{share}"


def risk_line(figures: dict[str, Any]) -> str:
    realised, recent = figures["realised_risk"], figures["recent_realised_risk"]
    parts = ["no attempt yet" if realised is None else f"{realised:.1%} of the attempts failed"]
    if recent is not None:
        parts.append(f"{recent:.1%} of the last 100")
    accepted, budget = figures["accepted_risk"], figures["accepted_hard_resets_per_1000"]
    parts.append(f"accepted {accepted:.1%}" if accepted is not None else f"accepted {budget:g} hard resets in 1,000 steps")
    return "; ".join(parts)
