"""What "reset" means, as functions of the user's say it."""

from __future__ import annotations

import math
from typing import Any

from ._settings import Settings

#: With a reset reward alone, a state that is worth more than this is in the reset set (the paper, appendix C).
RESET_SET_ABOVE = 0.7

NO_MEANING = (
    'nothing says what "reset" means: give reset_reward or in_reset_set, or name a `reset_task` in the configuration'
)


class Meaning:
    """What "reset" means, as functions of an observation say it."""

    def __init__(self, settings: Settings) -> None:
        reset_reward, in_reset_set = settings.get("reset_reward"), settings.get("in_reset_set")
        for name, function in (("reset_reward", reset_reward), ("in_reset_set", in_reset_set)):
            if function is not None and not callable(function):
                raise TypeError(f"{name} is {function!r}, not a function of an observation")
        self._reset_reward, self._in_reset_set = reset_reward, in_reset_set
        #: Whether there is such a function.
        self.is_told = reset_reward is not None or in_reset_set is not None

    def signal(self, observation: Any) -> tuple[float, bool] | None:
        """Reset reward, and whether it counts as reset; None where a reset task says so."""
        if not self.is_told:
            return None
        if self._reset_reward is None:
            is_reset = self._is_reset(observation)
            return float(is_reset), is_reset
        reward = self._reset_reward(observation)
        try:
            # Unlike `float`, it reads no text.
            is_finite = math.isfinite(reward)
        except (TypeError, ValueError) as error:
            raise TypeError(f"reset_reward gave {reward!r}, not a number") from error
        if not is_finite:
            raise ValueError(f"reset_reward gave {reward}, which is not finite")
        reward = float(reward)
        if self._in_reset_set is None:
            return reward, reward > RESET_SET_ABOVE
        return reward, self._is_reset(observation)

    def _is_reset(self, observation: Any) -> bool:
        assert self._in_reset_set is not None
        return told("in_reset_set", self._in_reset_set(observation))


def told(name: str, answer: Any) -> bool:
    """The answer of a function of the user's that gives a bool. Raises TypeError if it is none."""
    try:
        # Of numpy or torch.
        bare = answer.item()
    except (AttributeError, RuntimeError, ValueError):
        bare = answer
    if not isinstance(bare, bool):
        raise TypeError(f"{name} gave {answer!r}, not a bool")
    return bare
