"""A safety shield for reinforcement learning: it learns to undo, and stops what cannot be undone.

    import shield
    env = shield.ShieldedEnv(YourEnv(), in_reset_set=lambda observation: abs(observation[0]) < 0.1)

`ShieldedEnv` is a Gymnasium wrapper; `Shield` is for a loop of your own; `doctor` says before any training whether a shield can help.
"""

from ._core import ConfigError, ShieldError, __version__, usual_config
from ._doctor import Check, Checkup, doctor
from ._env import ShieldedEnv
from ._shield import Decision, Shield, ShieldWarning

__all__ = [
    "Check",
    "Checkup",
    "ConfigError",
    "Decision",
    "Shield",
    "ShieldError",
    "ShieldWarning",
    "ShieldedEnv",
    "__version__",
    "doctor",
    "usual_config",
]
