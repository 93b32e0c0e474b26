"""A user's reset policy, as the core calls it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ._spaces import Boxed, Chosen, Combined, Floats, Observations


def flat_policy(
    policy: Callable[[Any], Any] | None, observations: Observations, space: Boxed | Chosen | Combined
) -> Callable[[Floats], Floats] | None:
    """The policy on vectors. It raises where its action is not one of the action space."""
    if policy is None:
        return None
    if not callable(policy):
        raise TypeError(f"reset_policy is {policy!r}, not a function of an observation")
    buffer: Floats = np.zeros(space.length, np.float32)

    def way_home(seen: Floats) -> Floats:
        action = policy(observations.read(seen))
        space.read(action, buffer, "the action of reset_policy")
        if not space.has(buffer):
            raise ValueError(f"reset_policy gave {action!r}, which is not in the action space {space.space}")
        return buffer

    return way_home
