"""A shield for a loop of one's own."""

from __future__ import annotations

import math
import os
import pathlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from ._core import Core
from ._settings import overrides as as_overrides
from ._spaces import Floats, Observations, actions

#: With a reset reward alone, a state that is worth more than this is in the reset set (the paper, appendix C).
RESET_SET_ABOVE = 0.7

_PLUGINS = pathlib.Path(__file__).parent / "plugins"


class Decision(NamedTuple):
    """What the shield says of a proposed action."""

    #: `allow`, `warm_up` (nothing is aborted yet), `project` (altered so that every rule allows it), `abort` (the reset agent takes
    #: over), or `resetting` (the reset agent is in charge, nobody was asked).
    verdict: str
    #: What may be executed, whatever the verdict.
    action: Any
    #: What was proposed.
    proposed: Any
    #: Mean of the reset ensemble's values of the proposed action; None if no rule needed them.
    reset_value: float | None
    #: The id of the rule that rejected it; empty if none did.
    rule: str
    #: The class of the reason, such as `rejected` or `invalid_action`; empty if nothing was rejected.
    cause: str
    #: The reason, for a person.
    reason: str

    @property
    def allowed(self) -> bool:
        """Whether the task goes on: the action, as proposed or altered, may be executed."""
        return self.verdict in ("allow", "warm_up", "project")


class Shield:
    """Decides before every action whether it could be undone, and learns to undo.

    Each step: `filter` the proposed action, execute `decision.action`, `observe` where it led. After an abort the reset agent is in charge (`resetting`),
    and `filter` gives its actions, until its episode is over. Where `needs_hard_reset`, nothing may move before `hard_reset_done`.

    `reset_reward(observation)` is large, up to 1, where the environment is as at its start; `in_reset_set(observation)` says whether it is. One is enough, and
    without either the reset task of the configuration decides: nearness to the observed starts.
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        *,
        reset_reward: Callable[[Any], float] | None = None,
        in_reset_set: Callable[[Any], bool] | None = None,
        config: str | os.PathLike[str] | None = None,
        tensorboard: str | os.PathLike[str] | None = None,
        q_min: float | None = None,
        warm_up_steps: int | None = None,
        reset_attempts: int | str | None = None,
        episode_length: int | None = None,
        updates_per_step: int | None = None,
        seed: int | None = None,
        threads: int | None = None,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        settings = {
            "warm_up_steps": warm_up_steps,
            "reset_attempts": reset_attempts,
            "episode_length": episode_length,
            "updates_per_step": updates_per_step,
            "seed": seed,
            "threads": threads,
        }
        for name, function in (("reset_reward", reset_reward), ("in_reset_set", in_reset_set)):
            if function is not None and not callable(function):
                raise TypeError(f"{name} is {function!r}, not a function of an observation")
        sets = as_overrides(settings, q_min, overrides or {}, config is None)
        self._reset_reward, self._in_reset_set = reset_reward, in_reset_set
        self._is_told = reset_reward is not None or in_reset_set is not None
        if self._is_told:
            sets.insert(0, ("reset_task", "None", "reset_reward and in_reset_set"))
        self._observations, self._actions = Observations(observation_space), actions(action_space)
        low, high = self._observations.low.tolist(), self._observations.high.tolist()
        self._core = Core((low, high), self._actions.form, config, sets, _PLUGINS, tensorboard)
        if not self._is_told and not self._core.has_reset_task:
            raise ValueError(
                'nothing says what "reset" means: give reset_reward or in_reset_set, or name a `reset_task` in the'
                " configuration"
            )
        self._seen: Floats = self._observations.empty()
        self._buffer: Floats = np.zeros(self._actions.length, np.float32)

    def filter(self, observation: Any, action: Any) -> Decision:
        """Decides on an action; it must be one of the action space, else it is aborted (outside) or refused (wrong shape or dtype)."""
        self._observations.write(observation, self._seen)
        return self._decide(action)

    def _decide(self, action: Any) -> Decision:
        """As `filter`, of the observation that was reported last."""
        self._actions.read(action, self._buffer)
        verdict, reset_value, rule, cause, reason = self._core.filter(self._seen, self._buffer)
        is_unchanged = verdict == "allow" or verdict == "warm_up"
        return Decision(
            verdict,
            action if is_unchanged else self._actions.write(self._buffer),
            action,
            None if math.isnan(reset_value) else reset_value,
            self._core.rules[rule] if rule >= 0 else "",
            cause,
            reason,
        )

    def _reset_action(self) -> Any:
        """The reset agent's action, while it is in charge, of the observation that was reported last."""
        self._buffer[:] = 0.0
        self._core.filter(self._seen, self._buffer)
        return self._actions.write(self._buffer)

    def observe(self, observation: Any, *, terminated: bool = False) -> None:
        """`decision.action` was executed and led here. `terminated`: the environment cannot go on, a hard reset is needed."""
        self._observations.write(observation, self._seen)
        self._core.observe(self._seen, self._signal(observation), terminated)

    def hard_reset_done(self, observation: Any) -> None:
        """Everything is at its start, by a person's or the environment's doing."""
        self._observations.write(observation, self._seen)
        # What says what "reset" means fails here rather than after an action.
        self._signal(observation)
        self._core.hard_reset_done(self._seen)

    def _signal(self, observation: Any) -> tuple[float, bool] | None:
        if not self._is_told:
            return None
        if self._reset_reward is None:
            assert self._in_reset_set is not None
            is_reset = bool(self._in_reset_set(observation))
            return float(is_reset), is_reset
        reward = self._reset_reward(observation)
        try:
            reward = float(reward)
        except (TypeError, ValueError) as error:
            raise TypeError(f"reset_reward gave {reward!r}, not a number") from error
        if not math.isfinite(reward):
            raise ValueError(f"reset_reward gave {reward}, which is not finite")
        if self._in_reset_set is None:
            return reward, reward > RESET_SET_ABOVE
        return reward, bool(self._in_reset_set(observation))

    def begin_reset(self) -> bool:
        """Hands over to the reset agent although nothing was aborted: the task is done. Returns whether it is in charge."""
        return self._core.begin_reset()

    def require_hard_reset(self) -> None:
        """Nobody knows where the environment stands."""
        self._core.require_hard_reset()

    @property
    def resetting(self) -> bool:
        """Whether the reset agent is in charge of the next step."""
        return self._core.is_resetting

    @property
    def needs_hard_reset(self) -> bool:
        """Whether the reset agent has given up, or the environment has ended."""
        return self._core.needs_hard_reset

    def metrics(self) -> dict[str, float]:
        """Counts since the beginning, and the reset agent's figures as means over its present or last episode."""
        return self._core.metrics()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes everything that was learned and counted into a file."""
        self._core.save(path)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Goes on from a file of a shield with the same configuration; a hard reset is needed then."""
        self._core.load(path)
