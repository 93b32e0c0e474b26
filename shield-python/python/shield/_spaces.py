"""Gymnasium's spaces as flat vectors of 32-bit floats, which is what the shield sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

Floats = npt.NDArray[np.float32]

# Whole numbers above are not exact as 32-bit floats.
MOST_CHOICES = 2**24


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


class Observations:
    """Observations of any space with a fixed number of values."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        if not space.is_np_flattenable:
            raise ValueError(f"the observation space {space} has no fixed number of values")
        self.space = space
        flat = spaces.flatten_space(space)
        assert isinstance(flat, spaces.Box)
        self.low, self.high = flat.low.astype(np.float32), flat.high.astype(np.float32)

    def empty(self) -> Floats:
        return np.zeros(self.low.shape, np.float32)

    def write(self, observation: Any, into: Floats) -> None:
        """Flattens an observation into a vector."""
        into[:] = flattened(self.space, observation, "the observation")

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
                f"the action space {space} has infinite bounds: a reset agent cannot explore it. Give it finite ones,"
                " for example with gymnasium.wrappers.RescaleAction"
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

    def explained(self, reason: str, action: Any) -> str:
        """The reason why an action is not one of the space."""
        return reason

    def write(self, action: Floats) -> np.ndarray:
        # The bounds may be finer than 32-bit floats.
        values = action.reshape(self.space.shape).astype(self.space.dtype)
        return values.clip(self.space.low, self.space.high)

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


def actions(space: spaces.Space[Any]) -> Boxed | Chosen:
    if isinstance(space, spaces.Box):
        return Boxed(space)
    if isinstance(space, spaces.Discrete):
        return Chosen(space)
    raise ValueError(
        f"the action space is {space}; an action here is a Box or Discrete. gymnasium.wrappers.TransformAction can"
        " make it one"
    )
