"""A shield for a loop of one's own."""

from __future__ import annotations

import math
import os
import pathlib
import warnings
import weakref
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from gymnasium import spaces

from ._core import Core, Record, ShieldError, experience_bytes, written_at
from ._meaning import NO_MEANING, Meaning
from ._reset_policy import flat_policy
from ._settings import Settings, accepted_risk_of, overrides, overrides_of_first_rule, recorded, refuse_unknown
from ._spaces import Boxed, Floats, Observations, actions

if TYPE_CHECKING:
    from typing_extensions import Unpack

#: Of so many bytes of experience a person is told before they are used.
MUCH_MEMORY = 2**30

PLUGINS = pathlib.Path(__file__).parent / "plugins"


class Decision(NamedTuple):
    """What the shield says of a proposed action."""

    #: `allow`, `warm_up` (only rules that need nothing learned were asked), `project` (altered so that every rule allows it), `abort` (the reset agent takes
    #: over), or `resetting` (the reset agent is in charge, nobody was asked).
    verdict: str
    #: What may be executed, whatever the verdict; of a box, in the space's dtype.
    action: Any
    #: What was proposed.
    proposed: Any
    #: Mean of the reset ensemble's values of the proposed action; None if no rule needed them.
    reset_value: float | None
    #: The probability that the proposed action can be undone, the mean of the success critic's members; None if no rule needed it.
    undo_probability: float | None
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


class ShieldWarning(UserWarning):
    """Something keeps the shield from helping; the text says what was seen and what to do."""

    def __init__(self, message: str, name: str = "") -> None:
        super().__init__(message)
        #: The name of the finding, such as `starts-outside`.
        self.name = name


class Shield:
    """Decides before every action whether it could be undone, and learns to undo.

    Each step: `filter` the proposed action, execute `decision.action`, `observe` where it led. After an abort the reset agent is in charge (`resetting`),
    and `filter` gives its actions, until its episode is over. Where `needs_hard_reset`, nothing may move before `hard_reset_done`.

    What keeps the shield from helping is told once each, as a `ShieldWarning`.

    The arguments; None leaves what the configuration says:

    - `reset_reward(observation)` is large, up to 1, where the environment is as at its start; `in_reset_set(observation)` says, as a bool, whether it is. One is
      enough, and without either the reset task of the configuration decides: likeness to the observed starts.
    - `reset_policy(observation)` gives the action that leads home, in the place of a reset agent that learns; the shield learns how far it does. It
      is also asked about observations of the past, so it must not remember anything. Its observations are rounded to 32-bit floats.
    - `config`: a RON file; without one, `usual_config(is_discrete)`.
    - `tensorboard`: a folder for an event file with counts and the reset agent's figures.
    - `record`: a folder, new or empty, into which every decision is written; `shield explain` and `shield what-if` read it. Writing never changes a
      decision: where it fails, the record ends with a `ShieldWarning`. `close`, `save` and the end of the program write what waits in memory.
    - `record_every`: only the decisions of every n-th step (1), and every rejection. `record_limit`: decisions after which the record ends (1,000,000).
    - `accepted_risk`: the share of attempts to reset that may fail (0.2), for the rule `undo-probability`, which must be the first. A smaller one makes
      the shield stricter.
    - `q_min`: the least value at which an action is executed, for a first rule that has one, such as `ensemble-threshold`, in the rule's terms; where it
      has a schedule, what it grows to. The usual configuration has no such rule.
    - `warm_up_steps`: in the first so many steps (1,000) a rule that needs the reset agent's values is not asked. The usual rule has no warm-up.
    - `reset_attempts`: failures in a row (1) after which the reset agent gives up; "Unlimited" is never.
    - `attempt_length`: steps after which an attempt of the reset agent has failed. "Adaptive", the usual: three times as many as recent successes took (at first 200, or
      as many as there are to be undone), half as many more after each time-out, at most `episode_length`; "Episode": `episode_length`.
    - `episode_length`: the most steps (500) of an attempt, unless `attempt_length` is a number.
    - `calibration_resets`: before the first step the environment is reset so many more times (0), so that the reset task sees how far its starts scatter. In a
      simulator 20 are cheap; on a robot each is a hard reset by a person. They are not counted. `ShieldedEnv` makes them; in a loop of your own you do, and tell of
      each by `observe_start`.
    - `updates_per_step`: how often the reset agent learns after each step; 0 is never.
    - `update_every`: it learns after every n-th step (1) only; 4 makes a quarter of an update per step.
    - `seed`: of the shield's random numbers (0).
    - `threads`: how many the shield may use (1); what it decides does not depend on it.
    - `overrides`: any other field of the configuration by its path, as `{"reset.config.critics": 10}`; a string is RON.
    """

    def __init__(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any], **settings: Unpack[Settings]
    ) -> None:
        refuse_unknown(settings)
        record = recorded(settings)
        config = settings.get("config")
        self._meaning = Meaning(settings)
        #: Whether functions say what "reset" means, and no reset task.
        self.is_told = self._meaning.is_told
        self._observations, self._actions = Observations(observation_space), actions(action_space)
        #: Whether actions are a box of numbers, and no choices.
        self.is_box = isinstance(self._actions, Boxed)
        low, high = self._observations.low.tolist(), self._observations.high.tolist()

        sets = overrides(settings)
        if self.is_told:
            sets.insert(0, ("reset_task", "None", "reset_reward and in_reset_set"))

        def written(path: str) -> str | None:
            return written_at(config, not self.is_box, sets, path)

        way_home = flat_policy(settings.get("reset_policy"), self._observations, self._actions)
        if way_home is not None:
            # It takes the place of whatever agent the configuration names.
            sets.insert(0, ("reset", "None", "reset_policy"))
        # Last, for an override may have put another rule there.
        sets += overrides_of_first_rule(settings, written)
        if self._observations.are_bytes and written("experience.observations") is None:
            sets.insert(0, ("experience.observations", "Bytes", "observations of 8 bits"))
        size = experience_bytes((low, high), self._actions.form, config, sets)
        if size > MUCH_MEMORY:
            text = (
                f"the experience takes {size / 2**30:.1f} GiB once it is full, and memory is used as it fills. Observations have {len(low):,} numbers: show the shield"
                " smaller ones, or keep fewer transitions, overrides={\"experience.capacity\": 10_000}"
            )
            warnings.warn(ShieldWarning(f"{text} [much-memory]", "much-memory"), stacklevel=3)
        tensorboard = settings.get("tensorboard")
        self._core = Core((low, high), self._actions.form, config, sets, PLUGINS, tensorboard, way_home)
        #: The share of attempts that may fail, and how many hard resets per 1,000 steps, as the first rule accepts them; None where it does not.
        self.accepted_risk, self.accepted_hard_resets_per_1000 = accepted_risk_of(written)
        if not self.is_told and not self._core.has_reset_task:
            raise ValueError(NO_MEANING)
        #: How many findings were told.
        self._told = 0
        self._record: Record | None = None
        if record is not None:
            self._record = self._core.record(*record)
            # Nobody destroys what lives until the interpreter ends.
            weakref.finalize(self, self._record.flush)
        #: Whether nothing is learned and counted here.
        self.is_frozen = False
        self._seen: Floats = self._observations.empty()
        # What is wrong with it; empty if nothing is.
        self._fault = ""
        self._buffer: Floats = np.zeros(self._actions.length, np.float32)

    def filter(self, observation: Any, action: Any) -> Decision:
        """Decides on an action; it must be one of the action space, else it is aborted (outside) or refused (ValueError: wrong shape or dtype)."""
        self.look(observation)
        return self.decide(action)

    def look(self, observation: Any) -> None:
        """The environment shows this now, although nothing was executed: there is a new goal, or something was moved between two episodes."""
        self._fault = self._observations.write(observation, self._seen)

    def decide(self, action: Any) -> Decision:
        """As `filter`, at the observation that was reported last."""
        proposed = self._actions.read(action, self._buffer)
        verdict, reset_value, undo_probability, rule, cause, reason = self._core.filter(self._seen, self._buffer)
        if cause == "invalid_action":
            reason = self._actions.explained(reason, action)
        elif cause == "invalid_observation" and self._fault:
            reason = self._fault
        is_unchanged = verdict == "allow" or verdict == "warm_up"
        return Decision(
            verdict,
            proposed if is_unchanged else self._actions.write(self._buffer),
            action,
            None if math.isnan(reset_value) else reset_value,
            None if math.isnan(undo_probability) else undo_probability,
            self._core.rules[rule] if rule >= 0 else "",
            cause,
            reason,
        )

    def reset_action(self) -> Any:
        """The reset agent's action while it is in charge, at the observation that was reported last."""
        self._buffer[:] = 0.0
        self._core.filter(self._seen, self._buffer)
        return self._actions.write(self._buffer)

    def clipped(self, action: Any) -> Any:
        """An action of a box, brought into its bounds. What has no place there, such as NaN or a wrong shape, stays as it is."""
        return self._actions.clipped(action) if isinstance(self._actions, Boxed) else action

    def note_reward(self, reward: float, abort_reward: float) -> None:
        """Tells of the reward of the step that was just executed and of that of an abort, so that a finding can say where aborting pays."""
        self._core.note_reward(reward, abort_reward)

    def frozen(self) -> Shield:
        """The same shield for another environment with the same spaces, in which nothing is learned, explored or counted."""
        view = Shield.__new__(Shield)
        view.__dict__.update(self.__dict__)
        view._core, view._record, view.is_frozen = self._core.frozen(), None, True
        view._seen, view._buffer, view._fault = self._observations.empty(), self._buffer.copy(), ""
        return view

    def observe_start(self, observation: Any) -> None:
        """Shows the reset task one more start, from which nothing follows: for a simulator that can be reset a few times before the first step."""
        seen = self._observations.empty()
        fault = self._observations.write(observation, seen)
        if fault:
            raise ShieldError(fault)
        self._core.observe_start(seen)

    def observe(self, observation: Any, *, terminated: bool = False, irreversible: bool = False) -> None:
        """`decision.action` was executed and led here. `terminated`: the environment cannot go on, a hard reset is needed. `irreversible`: nobody can
        get back from here; entries into such states are counted (`irreversible_entries`), and nothing else follows.

        If it raises, a hard reset is needed as well: what was executed is not in the experience.
        """
        try:
            self.look(observation)
            if self._fault:
                raise ShieldError(self._fault)
            found = self._core.observe(self._seen, self._meaning.signal(observation), terminated, irreversible)
        except BaseException:
            self.require_hard_reset()
            raise
        if found > self._told:
            self._tell()

    def hard_reset_done(self, observation: Any) -> None:
        """Everything is at its start, by a person's or the environment's doing. If it raises, a hard reset is still needed."""
        self.require_hard_reset(requested=True)
        self.look(observation)
        if self._fault:
            raise ShieldError(self._fault)
        # What says what "reset" means fails here rather than after an action.
        signal = self._meaning.signal(observation)
        if self._core.hard_reset_done(self._seen, signal and signal[1]) > self._told:
            self._tell()

    def _tell(self) -> None:
        """Warns of what was found since the last time, and of a record that has ended."""
        new = self._core.findings(self._told)
        self._told += len(new)
        for name, text in new:
            warnings.warn(ShieldWarning(f"{text} [{name}]", name), stacklevel=3)
        trouble = None if self._record is None else self._record.take_trouble()
        if trouble is not None:
            warnings.warn(ShieldWarning(f"{trouble} [record]", "record"), stacklevel=3)

    def findings(self) -> list[tuple[str, str]]:
        """What keeps the shield from helping, as far as it was found: name and sentence, the earliest first. Each was a `ShieldWarning`, too."""
        return self._core.findings(0)

    def begin_reset(self) -> bool:
        """Hands over to the reset agent although nothing was aborted: the task is done. Returns whether it is in charge."""
        return self._core.begin_reset()

    def require_hard_reset(self, *, has_ended: bool = False, requested: bool = False) -> None:
        """Nothing may move before `hard_reset_done`: the environment has ended, somebody wants a hard reset, or where it stands is not known."""
        self._core.require_hard_reset(has_ended, requested)

    @property
    def placed(self) -> bool:
        """Whether a start was ever observed."""
        return self._core.is_placed

    @property
    def episode_length(self) -> int:
        """Steps of the present episode, of the agent in charge."""
        return self._core.episode_length

    @property
    def hard_reset_due(self) -> str:
        """Why a hard reset is needed: `cycle_over` (the reset agent has given up), `terminated`, `requested` (by the caller), or `lost` (where the
        environment stands is not known); empty if none is."""
        return self._core.hard_reset_due

    @property
    def calibration_resets(self) -> int:
        """How many more starts `observe_start` is to be told before the first step."""
        return self._core.calibration_resets

    @property
    def no_action(self) -> Any:
        """What stands for an action that was not executed: NaN, or for a Discrete space one less than its first action."""
        return self._actions.nothing()

    @property
    def resetting(self) -> bool:
        """Whether the reset agent is in charge of the next step."""
        return self._core.is_resetting

    @property
    def needs_hard_reset(self) -> bool:
        """Whether the reset agent has given up, or the environment has ended."""
        return self._core.needs_hard_reset

    @property
    def irreversible_entries(self) -> int:
        """How often `observe` was told of an irreversible state after one that was not."""
        return self._core.irreversible_entries

    def metrics(self) -> dict[str, float]:
        """Counts since the beginning, and the reset agent's figures as means over its present or last episode."""
        return self._core.metrics()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes everything that was learned and counted into a file, in one step: a failure leaves the old file as it was. Only a regular file is replaced;
        a folder, a device, a pipe or a symbolic link of that name raises."""
        self._refuse_if_frozen()
        self._core.save(path)
        self.close()

    def close(self) -> None:
        """Writes what waits in memory of the `record`, if there is one; whatever is decided afterwards is recorded as well."""
        if self._record is not None:
            self._record.flush()
            self._tell()

    def load(self, path: str | os.PathLike[str]) -> None:
        """Goes on from a file of a shield with the same spaces, reset agent, rules and reset task, whatever the rules' settings and the capacity of the
        experience (of more transitions than there is room for, the newest stay); a hard reset is needed then, also if it raises."""
        self._refuse_if_frozen()
        self._core.load(path)
        self._told = len(self._core.findings(0))

    def _refuse_if_frozen(self) -> None:
        if self.is_frozen:
            raise ShieldError("a frozen shield has nothing of its own to keep: use the one that learns")

    def __reduce__(self) -> NoReturn:
        raise TypeError(NOT_COPIED)

    __copy__ = __reduce__

    def __deepcopy__(self, _: Any) -> NoReturn:
        raise TypeError(NOT_COPIED)


NOT_COPIED = (
    "a Shield cannot be pickled or copied: it has threads and plugins. save(path) and load(path) keep what it has learned, frozen() is the same shield for another"
    " environment, and another process needs a shield of its own"
)
