"""Gymnasium's spaces as flat vectors of 32-bit floats, which is what the shield sees."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

Floats = npt.NDArray[np.float32]

# Whole numbers above are not exact as 32-bit floats.
MOST_CHOICES = 2**24


def described(value: np.ndarray) -> str:
    return f"shape {value.shape} and dtype {value.dtype}"


class Observations:
    """Observations of any space with a fixed number of values, through Gymnasium's `flatten`."""

    def __init__(self, space: spaces.Space[Any]) -> None:
        if not space.is_np_flattenable:
            raise ValueError(f"the observation space {space} has no fixed number of values")
        self.space = space
        self.is_box = isinstance(space, spaces.Box)
        flat = spaces.flatten_space(space)
        assert isinstance(flat, spaces.Box)
        self.low, self.high = flat.low.astype(np.float32), flat.high.astype(np.float32)

    def empty(self) -> Floats:
        return np.zeros(self.low.shape, np.float32)

    def write(self, observation: Any, into: Floats) -> None:
        """Flattens an observation into a vector."""
        if self.is_box:
            values = np.asarray(observation)
            if values.shape != self.space.shape or values.dtype.kind not in "fiub":
                raise ValueError(
                    f"the observation has {described(values)}; its space {self.space} wants shape"
                    f" {self.space.shape} and dtype {self.space.dtype}"
                )
            into[:] = values.reshape(-1)
            return
        try:
            values = np.asarray(spaces.flatten(self.space, observation))
        except (TypeError, ValueError, KeyError, IndexError) as error:
            raise ValueError(f"the observation {observation!r} does not fit its space {self.space}") from error
        if values.shape != into.shape:
            raise ValueError(
                f"the observation has {described(values)} when it is flattened; its space {self.space} wants shape"
                f" {into.shape}"
            )
        into[:] = values


class Boxed:
    """Actions of a box with finite bounds."""

    def __init__(self, space: spaces.Box) -> None:
        if not space.is_bounded():
            raise ValueError(
                f"the action space {space} has infinite bounds: a reset agent cannot explore it. Give it finite ones,"
                " for example with gymnasium.wrappers.RescaleAction"
            )
        self.space = space
        self.form = tuple(bound.astype(np.float32).reshape(-1).tolist() for bound in (space.low, space.high))
        self.length = int(np.prod(space.shape))

    def read(self, action: Any, into: Floats) -> None:
        values = np.asarray(action)
        if values.shape != self.space.shape or values.dtype.kind not in "fiu":
            raise ValueError(
                f"the action has {described(values)}; the action space {self.space} wants shape {self.space.shape}"
                f" and dtype {self.space.dtype}"
            )
        into[:] = values.reshape(-1)

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

    def read(self, action: Any, into: Floats) -> None:
        value = np.asarray(action)
        if value.shape != () or value.dtype.kind not in "iu":
            raise ValueError(
                f"the action has {described(value)}; the action space {self.space} wants shape () and dtype"
                f" {self.space.dtype}"
            )
        into[0] = int(value) - self.start

    def write(self, action: Floats) -> np.integer[Any]:
        return self.space.dtype.type(int(action[0]) + self.start)

    def nothing(self) -> np.integer[Any]:
        return self.space.dtype.type(self.start - 1)


def actions(space: spaces.Space[Any]) -> Boxed | Chosen:
    if isinstance(space, spaces.Box):
        return Boxed(space)
    if isinstance(space, spaces.Discrete):
        return Chosen(space)
    raise ValueError(
        f"the action space is {space}; an action here is a Box or Discrete. gymnasium.wrappers.TransformAction can"
        " make it one"
    )
