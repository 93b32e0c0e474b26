"""The shield as a Gymnasium wrapper."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs, seeding

from ._chain import SIMULATED_STARTS, Simulation, five, is_simulated, refuse_misfits, warn_of_drift, without_time_limits
from ._meaning import told
from ._report import figures_of, text_of
from ._settings import Settings
from ._shield import Decision, Shield, ShieldWarning
from ._spaces import owned

if TYPE_CHECKING:
    from typing_extensions import Unpack


class ShieldedEnv(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """An environment in which any agent is shielded and need not know.

    A step whose action is aborted is not executed: the observation is as before, the reward is `abort_reward`, `truncated` is True. The next `reset()` is
    soft: it lets the reset agent undo what was done. The environment itself is reset only when that fails `reset_attempts` times in a row, when it has
    terminated or truncated itself, or when `reset` is given a seed or options.

    `TimeLimit`s inside are taken out; the wrapper counts in their place, and begins anew with each reset.

    `info["shield"]` of a step has the keys `verdict`, `proposed`, `executed`, `reset_value`, `undo_probability`, `rule`, `cause` and `reason`, as in
    `Decision`; of an aborted step `executed` is NaN, or where actions are choices one less than the first. `info["shield"]` of a reset has `hard_reset`,
    `steps` (of the reset agent) and `cause` (of a hard reset). An aborted step and a soft reset bring the environment's last info again; `is_repeated` says so.

    Four arguments are its own:

    - `abort_reward`: the reward of a step that was aborted. Where most rewards are below, aborting pays; a `ShieldWarning` says so.
    - `clip`: brings an action of a box into its bounds before it is judged (False). Without it, an action outside is aborted.
    - `on_soft_reset(env)` is called after each soft reset with the environment inside, to draw a new goal or to randomise the domain. It returns what is
      observed then, or None if that is as before.
    - `is_irreversible(observation)` says, as a bool, whether there is no way back from there. It changes nothing; entries into such states are counted, in the
      steps of both agents.

    The other arguments are those of `Shield`, where each is explained. Two of them have other defaults here if there is no `config`: `episode_length` is the time
    limit of the environment if it has one, and `calibration_resets` is 20 for the environments that Gymnasium brings itself, which are simulators.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        reset_reward: Callable[[Any], float] | None = None,
        in_reset_set: Callable[[Any], bool] | None = None,
        config: str | os.PathLike[str] | None = None,
        *,
        abort_reward: float = 0.0,
        clip: bool = False,
        is_irreversible: Callable[[Any], bool] | None = None,
        on_soft_reset: Callable[[gymnasium.Env[Any, Any]], Any] | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        settings |= {"reset_reward": reset_reward, "in_reset_set": in_reset_set, "config": config}
        own = {"abort_reward": abort_reward, "clip": clip, "is_irreversible": is_irreversible, "on_soft_reset": on_soft_reset}
        RecordConstructorArgs.__init__(self, _disable_deepcopy=True, **own, **settings)
        for name, function in (("is_irreversible", is_irreversible), ("on_soft_reset", on_soft_reset)):
            if function is not None and not callable(function):
                raise TypeError(f"{name} is {function!r}, not a function")
        self._surround(env)
        env = self.env
        if clip and not isinstance(env.action_space, gymnasium.spaces.Box):
            raise ValueError(f"clip=True is for a box of actions; the action space is {env.action_space}")
        if settings.get("episode_length") is None and config is None and self._limit is not None:
            settings["episode_length"] = self._limit
        is_free = config is None and settings["reset_reward"] is None and settings["in_reset_set"] is None
        if settings.get("calibration_resets") is None and is_free and is_simulated(env):
            settings["calibration_resets"] = SIMULATED_STARTS
        self.abort_reward, self._clip = float(abort_reward), clip
        self._is_irreversible, self._on_soft_reset = is_irreversible, on_soft_reset
        #: The shield itself.
        self.shield = Shield(env.observation_space, env.action_space, **settings)

    def _surround(self, env: gymnasium.Env[Any, Any]) -> None:
        """Takes its place around an environment."""
        refuse_misfits(env, has_reset_policy=self._saved_kwargs.get("reset_policy") is not None)
        warn_of_drift(env, stacklevel=3)
        env, self._limit = without_time_limits(env)
        gymnasium.Wrapper.__init__(self, env)
        self._simulation = Simulation(env)
        # What the environment showed last.
        self._observation: Any = None
        self._info: dict[str, Any] = {}
        self._invalid_actions = 0
        self._is_told_of_masks = self._saved_kwargs.get("reset_policy") is not None

    def frozen(self, env: gymnasium.Env[Any, Any]) -> ShieldedEnv:
        """Another environment with the same spaces behind the same shield, for an evaluation: `EvalCallback(env.frozen(make()))`.

        It decides and resets as the shield does at that moment of its training, but nothing there is learned, explored, counted or told. `metrics`, `report` and
        `findings` are those of the training. Raises ValueError where the spaces differ.
        """
        for name in ("observation_space", "action_space"):
            own, other = getattr(self.env, name), getattr(env, name)
            if own != other:
                raise ValueError(f"the {name} of the other environment is {other}, and that of the shield is {own}")
        view = ShieldedEnv.__new__(ShieldedEnv)
        view._saved_kwargs = self._saved_kwargs
        view._surround(env)
        if view._limit is None:
            view._limit = self._limit
        view.abort_reward, view._clip = self.abort_reward, self._clip
        view._is_irreversible, view._on_soft_reset = self._is_irreversible, self._on_soft_reset
        view.shield = self.shield.frozen()
        return view

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Executes the action, as proposed or altered, if the shield allows it; `info["shield"]` says what it decided.

        Where it is aborted, nothing is executed: the observation is as before, the reward is `abort_reward`, `truncated` is True. Raises `ResetNeeded` where
        `reset()` must come first, and ValueError if the action's shape or dtype is wrong; nothing is executed then either.
        """
        shield = self.shield
        if not shield.placed or shield.resetting or shield.needs_hard_reset:
            raise gymnasium.error.ResetNeeded(self._why_not())
        decision = shield.decide(shield.clipped(action) if self._clip else action)._replace(proposed=action)
        if not decision.allowed:
            self._note_rejected(decision)
            said = explained(decision, shield.no_action, is_repeated=True)
            return owned(self._observation), self.abort_reward, False, True, {**self._info, "shield": said}
        observation, reward, terminated, truncated, info = self._execute(decision.action)
        shield.note_reward(float(reward), self.abort_reward)
        info["shield"] = explained(decision, decision.action)
        is_over = self._limit is not None and shield.episode_length >= self._limit
        return observation, reward, terminated, truncated or is_over, info

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Makes a soft reset: lets the reset agent act until the environment is as at its start. Only if that fails, the reset is hard: the environment's own.

        It is hard at once if the environment has ended, if a step was interrupted, or if a seed or options are given. `options={"soft_reset": True}` asks for a
        soft one all the same: the seed is then that of the environment's `np_random`, from which `on_soft_reset` may draw, and seed and options go to the hard
        reset if it comes to one. `options={"soft_reset": False}` asks for a hard one. Empty options are none.

        `info["shield"]` says which it was (`hard_reset`), how many `steps` the reset agent made, and the `cause` of a hard reset: `first`, `requested`,
        `terminated` (the environment had ended), `cycle_over` (the reset agent has given up) or `lost` (where the environment stood was not known).
        """
        shield, steps = self.shield, 0
        wants_soft, options = without_wish(options)
        if wants_soft is None:
            wants_soft = seed is None and options is None
        if shield.placed and wants_soft:
            steps = self._undo()
            if not shield.needs_hard_reset:
                self._after_soft_reset(seed)
                said = {"hard_reset": False, "steps": steps, "cause": "", "is_repeated": True}
                return owned(self._observation), {**self._info, "shield": said}
        cause = shield.hard_reset_due or ("requested" if shield.placed else "first")
        self._calibrate(seed, options)
        if shield.placed:
            # If the environment's own reset raises, another must follow.
            shield.require_hard_reset(requested=True)
        observation, info = self.env.reset(seed=seed, options=options)
        info = dict(info)
        shield.hard_reset_done(observation)
        self._observation, self._info = owned(observation), kept(info)
        self._note_masks()
        said = {"hard_reset": True, "steps": steps, "cause": cause, "is_repeated": False}
        return owned(observation), {**info, "shield": said}

    def run(self, policy: Callable[[Any], Any], steps: int, *, seed: int | None = None) -> list[float]:
        """Lets a finished policy, a function from observation to action, act for so many steps. Returns the return of each episode; the last may
        be cut short."""
        returns: list[float] = []
        is_over = True
        for _ in range(steps):
            if is_over:
                observation, _ = self.reset(seed=None if returns else seed)
                returns.append(0.0)
            observation, reward, terminated, truncated, _ = self.step(policy(observation))
            returns[-1] += float(reward)
            is_over = terminated or truncated
        return returns

    def metrics(self) -> dict[str, float]:
        """Counts since the beginning, and the reset agent's figures; with `is_irreversible` also `irreversible_entries`."""
        counted = self.shield.metrics()
        if self._is_irreversible is not None:
            counted["irreversible_entries"] = float(self.shield.irreversible_entries)
        return counted

    def report(self, *, as_dict: bool = False) -> str | dict[str, Any]:
        """Says in a few lines what the shield has done so far, what it cost, and whether it helps.

        `as_dict` gives the figures by name; those that are not known are None.
        """
        shield = self.shield
        risk = shield.accepted_risk, shield.accepted_hard_resets_per_1000
        counted = self.metrics()
        # One that is under way has no outcome yet.
        counted["reset_episodes"] -= shield.resetting
        figures = figures_of(counted, *risk, self._limit, self.findings())
        return figures if as_dict else text_of(figures)

    def findings(self) -> list[tuple[str, str]]:
        """What keeps the shield from helping, as `Shield.findings`."""
        return self.shield.findings()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes everything that the shield has learned and counted into a file, as `Shield.save`."""
        self.shield.save(path)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Goes on from a file, as `Shield.load`. The next `reset` is the environment's own; what `calibration_resets` were for is in the file."""
        self.shield.load(path)

    def close(self) -> None:
        """Closes the environment, and writes what waits in memory of the `record`."""
        try:
            super().close()
        finally:
            self.shield.close()

    def _calibrate(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Before the first start, shows the reset task some others. The first start itself is that of its seed, with or without them."""
        for number in range(self.shield.calibration_resets):
            start, _ = self.env.reset(seed=None if seed is None else seed + 1 + number, options=options)
            self.shield.observe_start(start)

    def _execute(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        try:
            self._simulation.begin()
            observation, reward, terminated, truncated, info = five(self.env.step(action))
            truncated, info = bool(truncated), dict(info)
            if self._simulation.has_exploded():
                # It shows its start, and nothing led there.
                self.shield.require_hard_reset()
                truncated = True
                self._warn("MuJoCo reset the simulation by itself because its numbers were too large: a hard reset follows, and nothing was learned from the step", "simulation-exploded")
            else:
                irreversible = self._is_irreversible is not None and told("is_irreversible", self._is_irreversible(observation))
                self.shield.observe(observation, terminated=bool(terminated), irreversible=irreversible)
                if truncated:
                    # It has ended its episode by itself, and does not promise to go on from here.
                    self.shield.require_hard_reset(has_ended=True)
            self._observation, self._info = owned(observation), kept(info)
        except BaseException:
            # Where the environment stands is not known.
            self.shield.require_hard_reset()
            raise
        return owned(observation), reward, terminated, truncated, info

    def _after_soft_reset(self, seed: int | None) -> None:
        """Seeds the environment's random numbers, and lets the user change what shall be different in the next episode."""
        try:
            if seed is not None:
                self.env.unwrapped.np_random = seeding.np_random(seed)[0]
            seen = self._on_soft_reset(self.env) if self._on_soft_reset is not None else None
            if seen is not None:
                self.shield.look(seen)
                self._observation = owned(seen)
        except BaseException:
            self.shield.require_hard_reset()
            raise

    def _note_rejected(self, decision: Decision) -> None:
        """Tells once that actions lie outside the space again and again."""
        is_outside = decision.cause == "invalid_action" and bool(np.isfinite(decision.proposed).all())
        self._invalid_actions += is_outside
        if is_outside and self._invalid_actions == MANY_INVALID:
            remedy = (
                "Put ClipAction around the shield, gymnasium.wrappers.ClipAction(env), or give clip=True"
                if self.shield.is_box
                else "See to it that the agent chooses among the actions of the space"
            )
            self._warn(f"{MANY_INVALID} actions were aborted because they are not in the action space ({decision.reason}). {remedy}", "invalid-actions")

    def _note_masks(self) -> None:
        """Tells once that the environment allows some actions only."""
        if "action_mask" in self._info and not self._is_told_of_masks:
            self._is_told_of_masks = True
            text = "the environment gives an action mask in its info, and a reset agent that learns does not know it. If masked actions do harm, give `reset_policy`, a function that keeps to the mask"
            self._warn(text, "masks-ignored")

    def _warn(self, text: str, name: str) -> None:
        warnings.warn(ShieldWarning(f"{text} [{name}]", name), stacklevel=4)

    def __reduce__(self) -> NoReturn:
        raise TypeError(NOT_COPIED)

    __copy__ = __reduce__

    def __deepcopy__(self, _: Any) -> NoReturn:
        raise TypeError(NOT_COPIED)

    def _undo(self) -> int:
        """Lets the reset agent act until its episode is over; returns the number of its steps."""
        shield, steps = self.shield, 0
        shield.begin_reset()
        while shield.resetting:
            self._execute(shield.reset_action())
            steps += 1
        return steps

    def _why_not(self) -> str:
        if not self.shield.placed:
            return "call reset() before step()"
        if self.shield.hard_reset_due == "lost":
            return "the last step was interrupted, so that it is not known where the environment stands: call reset()"
        if self.shield.hard_reset_due == "requested":
            return "the last reset did not come to its end: call reset()"
        if self.shield.resetting:
            return "the last action was aborted: call reset(), which lets the reset agent undo what was done"
        return "the environment has ended, or the reset agent has given up: call reset()"


#: Actions outside the space after which a remedy is told: fewer may be chance.
MANY_INVALID = 10

NOT_COPIED = (
    "a ShieldedEnv cannot be pickled or copied: its shield has threads and plugins. save(path) and load(path) keep what was learned; for another process, make the"
    " environment in the function that it runs; for an evaluation, frozen(other_env) puts another environment behind the same shield"
)

#: What wrappers inside add at the end of an episode, which must not be told twice.
OF_AN_END = {"episode", "final_info", "final_observation", "terminal_observation", "TimeLimit.truncated"}


def kept(info: dict[str, Any]) -> dict[str, Any]:
    """What may be told of again."""
    return {name: value for name, value in info.items() if name not in OF_AN_END}


def without_wish(options: dict[str, Any] | None) -> tuple[bool | None, dict[str, Any] | None]:
    """Whether a soft reset is wanted, None if that is not said; and the options of the environment, None if there are none."""
    if not options or "soft_reset" not in options:
        return None, options or None
    options = dict(options)
    wish = options.pop("soft_reset")
    if not isinstance(wish, (bool, np.bool_)):
        raise TypeError(f"options['soft_reset'] is {wish!r}, not a bool")
    return bool(wish), options or None


def explained(decision: Decision, executed: Any, *, is_repeated: bool = False) -> dict[str, Any]:
    return {
        "verdict": decision.verdict,
        "proposed": decision.proposed,
        "executed": executed,
        "reset_value": decision.reset_value,
        "undo_probability": decision.undo_probability,
        "rule": decision.rule,
        "cause": decision.cause,
        "reason": decision.reason,
        "is_repeated": is_repeated,
    }
