"""Gymnasium's spaces as flat vectors of 32-bit floats, which is what the shield sees."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

Floats = npt.NDArray[np.float32]

# Whole numbers above are not exact as 32-bit floats.
MOST_CHOICES = 2**24
#: The reset agent has an output for each.
MOST_COMBINATIONS = 4096


def described(value: np.ndarray) -> str:
    return f"shape {value.shape} and dtype {value.dtype}"


def flattened(space: spaces.Space[Any], value: Any, name: str) -> np.ndarray:
    """A value as a vector in the order of Gymnasium's `flatten`, which itself takes much that is not of the space. `name` says which part it is."""
    if isinstance(space, spaces.Box):
        values = np.asarray(value)
        if values.shape != space.shape or values.dtype.kind not in "fiub":
            raise ValueError(
                f"{name} has {described(values)}; its space {space} wants shape {space.shape} and dtype {space.dtype}"
            )
        return values.reshape(-1)
    if isinstance(space, spaces.Dict):
        if isinstance(value, Mapping) and value.keys() == space.spaces.keys():
            parts = space.spaces.items()
            return np.concatenate([flattened(part, value[key], f"{name}[{key!r}]") for key, part in parts])
    elif isinstance(space, spaces.Tuple):
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if isinstance(value, (tuple, list)) and len(value) == len(space.spaces):
            parts = enumerate(space.spaces)
            return np.concatenate([flattened(part, value[index], f"{name}[{index}]") for index, part in parts])
    elif space.contains(value):
        return np.asarray(spaces.flatten(space, value))
    raise ValueError(f"{name} is {value!r}, which is not one of its space {space}")


def owned(value: Any) -> Any:
    """A copy of an observation of which nobody else has a part."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, Mapping):
        return type(value)((key, owned(part)) for key, part in value.items())
    if type(value) in (tuple, list):
        return type(value)(map(owned, value))
    return copy.deepcopy(value)


def is_of_bytes(space: spaces.Space[Any]) -> bool:
    """Whether all of a space are boxes of unsigned integers of 8 bits."""
    if isinstance(space, spaces.Dict):
        return all(map(is_of_bytes, space.spaces.values()))
    if isinstance(space, spaces.Tuple):
        return all(map(is_of_bytes, space.spaces))
    return isinstance(space, spaces.Box) and space.dtype == np.uint8


#: The largest number that fits in 32 bits.
LARGEST = float(np.finfo(np.float32).max)


def not_finite(space: spaces.Space[Any], value: Any, name: str) -> str:
    """Which part of an observation of the space is not finite, where, and what to do; empty if everything is."""
    if isinstance(space, (spaces.Dict, spaces.Tuple)):
        named = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        return next(filter(None, (not_finite(part, value[key], f"{name}[{key!r}]") for key, part in named)), "")
    values = np.asarray(value) if isinstance(space, spaces.Box) else np.zeros(0)
    bad = np.argwhere(~(np.abs(values.astype(np.float64)) <= LARGEST))
    if not len(bad):
        return ""
    index = tuple(bad[0].tolist())
    where = "" if not index else f" at index {index[0] if len(index) == 1 else index}"
    number, more = values[index], f" (and {len(bad) - 1} more)" if len(bad) > 1 else ""
    if np.isfinite(number):
        return f"{name} has {number!r}{where}{more}, which is more than a 32-bit float holds ({LARGEST:.1e}): scale it, for example with {BY_HAND}"
    what, remedy = ("NaN", "find out where it comes from") if np.isnan(number) else (str(number), f"clip it, for example with {BY_HAND}")
    return f"{name} has {what}{where}{more}: {remedy}"


BY_HAND = "gymnasium.wrappers.TransformObservation inside the shield"


class Observations:
    """Observations of any space with a fixed number of values."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        if not space.is_np_flattenable:
            raise ValueError(f"the observation space {space} has no fixed number of values")
        self.space = space
        flat = spaces.flatten_space(space)
        assert isinstance(flat, spaces.Box)
        self.low, self.high = flat.low.astype(np.float32), flat.high.astype(np.float32)

    @property
    def are_bytes(self) -> bool:
        """Whether each number of theirs is one byte, as those of images."""
        return is_of_bytes(self.space)

    def empty(self) -> Floats:
        return np.zeros(self.low.shape, np.float32)

    def write(self, observation: Any, into: Floats) -> str:
        """Flattens an observation into a vector. Returns what is not finite in it; empty if everything is."""
        values = flattened(self.space, observation, "the observation")
        with np.errstate(over="ignore"):
            into[:] = values
        return "" if np.isfinite(into).all() else not_finite(self.space, observation, "the observation")

    def read(self, seen: Floats) -> Any:
        """The observation behind a vector."""
        return spaces.unflatten(self.space, seen)


class Boxed:
    """Actions of a box of fractions with finite bounds."""

    def __init__(self, space: spaces.Box) -> None:
        if space.dtype.kind != "f":
            raise ValueError(
                f"the action space {space} has whole numbers only: an altered action and those of the reset agent lie between them. Make it a Discrete"
                " space, or one of floats that the environment rounds"
            )
        if not space.is_bounded():
            raise ValueError(
                f"the action space {space} has infinite bounds: a reset agent cannot explore it. Give it finite ones:"
                " gymnasium.wrappers.TransformAction(env, lambda action: action, gymnasium.spaces.Box(low, high)); a ClipAction belongs around the shield"
            )
        self.space = space
        low, high = (bound.astype(np.float32).reshape(-1) for bound in (space.low, space.high))
        self.form = low.tolist(), high.tolist()
        self.low, self.high = low, high
        self.below, self.above = np.nextafter(low, np.float32(-np.inf)), np.nextafter(high, np.float32(np.inf))
        self.length = int(np.prod(space.shape))
        self.is_single = space.dtype == np.float32

    def has(self, action: Floats) -> bool:
        return bool(np.all((action >= self.low) & (action <= self.high)))

    def read(self, action: Any, into: Floats, name: str = "the action") -> np.ndarray:
        """Flattens an action into a vector, and returns it in the space's dtype: what is judged is what may be executed."""
        values = np.asarray(action)
        if values.shape != self.space.shape or values.dtype.kind not in "fiu":
            raise ValueError(
                f"{name} has {described(values)}; the action space {self.space} wants shape {self.space.shape}"
                f" and dtype {self.space.dtype}"
            )
        values = values.astype(self.space.dtype, copy=False)
        into[:] = values.reshape(-1)
        if not self.is_single:
            # What is outside stays there, though 32-bit floats are rounded to the bound.
            np.maximum(into, self.above, out=into, where=(values > self.space.high).reshape(-1))
            np.minimum(into, self.below, out=into, where=(values < self.space.low).reshape(-1))
        return values

    def clipped(self, action: Any) -> Any:
        """The action within the bounds; what cannot be compared with them stays as it is, to be refused."""
        values = np.asarray(action)
        if values.shape != self.space.shape or values.dtype.kind not in "fiu":
            return action
        return np.asarray(values.clip(self.space.low, self.space.high))

    def explained(self, reason: str, action: Any) -> str:
        """The reason why an action is not one of the space."""
        return reason

    def write(self, action: Floats) -> np.ndarray:
        # The bounds may be finer than 32-bit floats.
        values = action.reshape(self.space.shape).astype(self.space.dtype)
        # Of a scalar box, a number becomes an array again.
        return np.asarray(values.clip(self.space.low, self.space.high))

    def nothing(self) -> np.ndarray:
        return np.full(self.space.shape, np.nan, np.float32)


class Chosen:
    """Actions of a Discrete space."""

    length = 1

    def __init__(self, space: spaces.Discrete) -> None:
        if space.n > MOST_CHOICES:
            raise ValueError(f"the action space {space} has more than {MOST_CHOICES} actions")
        self.space = space
        self.form, self.start = int(space.n), int(space.start)

    def has(self, action: Floats) -> bool:
        return bool(0 <= action[0] < self.form)

    def read(self, action: Any, into: Floats, name: str = "the action") -> Any:
        value = np.asarray(action)
        if value.shape != () or value.dtype.kind not in "iu":
            raise ValueError(
                f"{name} has {described(value)}; the action space {self.space} wants shape () and dtype"
                f" {self.space.dtype}"
            )
        into[0] = int(value) - self.start
        return action

    def explained(self, reason: str, action: Any) -> str:
        # The shield counts from 0.
        return f"action {action} is not one of {self.start} to {self.start + self.form - 1}"

    def write(self, action: Floats) -> np.integer[Any]:
        return self.space.dtype.type(int(action[0]) + self.start)

    def nothing(self) -> np.integer[Any]:
        # The space's own dtype may have no room for it.
        return np.int64(self.start - 1)


class Combined:
    """Actions of several choices at once, MultiDiscrete or MultiBinary, as one choice among all combinations."""

    length = 1

    def __init__(self, space: spaces.MultiDiscrete | spaces.MultiBinary) -> None:
        self.space = space
        is_binary = isinstance(space, spaces.MultiBinary)
        self.choices = np.full(space.shape, 2) if is_binary else np.asarray(space.nvec)
        self.start = np.zeros(space.shape, np.int64) if is_binary else np.asarray(space.start, np.int64)
        number = math.prod(self.choices.reshape(-1).tolist())
        if number > MOST_COMBINATIONS:
            raise ValueError(
                f"the action space {space} has {number:,} combinations; the reset agent chooses among at most {MOST_COMBINATIONS:,}."
                " gymnasium.wrappers.TransformAction can make it a smaller Discrete space, or a Box that the environment rounds"
            )
        self.form = number

    def has(self, action: Floats) -> bool:
        return bool(0 <= action[0] < self.form)

    def read(self, action: Any, into: Floats, name: str = "the action") -> Any:
        values = np.asarray(action)
        if values.shape != self.space.shape or values.dtype.kind not in "iu":
            raise ValueError(
                f"{name} has {described(values)}; the action space {self.space} wants shape {self.space.shape} and dtype {self.space.dtype}"
            )
        chosen = values.astype(np.int64) - self.start
        is_inside = bool(np.all((chosen >= 0) & (chosen < self.choices)))
        into[0] = np.ravel_multi_index(tuple(chosen.reshape(-1)), tuple(self.choices.reshape(-1))) if is_inside else -1.0
        return action

    def explained(self, reason: str, action: Any) -> str:
        return f"action {np.asarray(action).tolist()} is not one of {self.space}"

    def write(self, action: Floats) -> np.ndarray:
        chosen = np.unravel_index(int(action[0]), tuple(self.choices.reshape(-1)))
        return (np.array(chosen).reshape(self.space.shape) + self.start).astype(self.space.dtype)

    def nothing(self) -> np.ndarray:
        return self.start - 1


def actions(space: spaces.Space[Any]) -> Boxed | Chosen | Combined:
    if isinstance(space, spaces.Box):
        return Boxed(space)
    if isinstance(space, spaces.Discrete):
        return Chosen(space)
    if isinstance(space, (spaces.MultiDiscrete, spaces.MultiBinary)):
        return Combined(space)
    raise ValueError(
        f"the action space is {space}; an action here is a Box, Discrete, MultiDiscrete or MultiBinary. gymnasium.wrappers.TransformAction can"
        " make it one"
    )
