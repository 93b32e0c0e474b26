import os
from collections.abc import Callable
from typing import Final, final

import numpy as np
import numpy.typing as npt

__version__: Final[str]

#: The accepted risk where nothing is said.
USUAL_RISK: Final[float]

class ConfigError(ValueError):
    """A setting that must be changed, with its place."""

class ShieldError(RuntimeError):
    """The shield or a plugin of it failed."""

def usual_config(is_discrete: bool) -> str:
    """The configuration, as RON, that is used for a box of actions or for a choice of them."""

def written_at(
    config: str | os.PathLike[str] | None, is_discrete: bool, sets: list[tuple[str, str, str]], path: str
) -> str | None:
    """The RON text at a path of the configuration, with the overrides; None where nothing is written."""

def experience_bytes(
    observation: tuple[list[float], list[float]],
    action: tuple[list[float], list[float]] | int,
    config: str | os.PathLike[str] | None,
    sets: list[tuple[str, str, str]],
) -> int:
    """Bytes that the experience takes once it is full; nothing is allocated yet."""

@final
class Record:
    def flush(self) -> None: ...
    def take_trouble(self) -> str | None: ...

@final
class Core:
    rules: list[str]
    has_reset_task: bool
    def __new__(
        cls,
        observation: tuple[list[float], list[float]],
        action: tuple[list[float], list[float]] | int,
        config: str | os.PathLike[str] | None,
        sets: list[tuple[str, str, str]],
        plugins: str | os.PathLike[str],
        tensorboard: str | os.PathLike[str] | None,
        reset_policy: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]] | None,
    ) -> Core: ...
    def record(self, folder: str | os.PathLike[str], every: int | None, limit: int | None) -> Record: ...
    def filter(
        self, observation: npt.NDArray[np.float32], action: npt.NDArray[np.float32]
    ) -> tuple[str, float, float, int, str, str]: ...
    def observe(
        self,
        observation: npt.NDArray[np.float32],
        signal: tuple[float, bool] | None,
        terminated: bool,
        irreversible: bool,
    ) -> int: ...
    def frozen(self) -> Core: ...
    def note_reward(self, reward: float, abort_reward: float) -> None: ...
    def observe_start(self, observation: npt.NDArray[np.float32]) -> int: ...
    def hard_reset_done(self, observation: npt.NDArray[np.float32], is_inside: bool | None) -> int: ...
    def findings(self, told: int) -> list[tuple[str, str]]: ...
    def begin_reset(self) -> bool: ...
    def require_hard_reset(self, has_ended: bool, is_requested: bool) -> None: ...
    @property
    def is_resetting(self) -> bool: ...
    @property
    def needs_hard_reset(self) -> bool: ...
    @property
    def hard_reset_due(self) -> str: ...
    @property
    def episode_length(self) -> int: ...
    @property
    def calibration_resets(self) -> int: ...
    @property
    def irreversible_entries(self) -> int: ...
    @property
    def is_placed(self) -> bool: ...
    def metrics(self) -> dict[str, float]: ...
    def save(self, path: str | os.PathLike[str]) -> None: ...
    def load(self, path: str | os.PathLike[str]) -> None: ...

@final
class Examination:
    USUAL: Final[tuple[int, int]]
    has_reset_task: bool
    def __new__(
        cls,
        observation: tuple[list[float], list[float]],
        action: tuple[list[float], list[float]] | int,
        config: str | os.PathLike[str] | None,
        sets: list[tuple[str, str, str]],
        plugins: str | os.PathLike[str],
    ) -> Examination: ...
    def start(self, observation: npt.NDArray[np.float32], is_inside: bool | None) -> None: ...
    def walk(self) -> None: ...
    def step(
        self, observation: npt.NDArray[np.float32], is_inside: bool | None, terminated: bool, truncated: bool
    ) -> None: ...
    def is_walk_over(self, steps: int, of: int) -> bool: ...
    def conclude(self) -> tuple[list[tuple[str, str, str, str]], str, str]: ...
