"""A safety shield for reinforcement learning: it learns to undo, and stops what cannot be undone.

    import gymnasium, shield
    env = shield.ShieldedEnv(gymnasium.make("InvertedPendulum-v5"))

`ShieldedEnv` is a Gymnasium wrapper; `Shield` is for a loop of your own.
"""

from ._core import ConfigError, ShieldError, __version__, usual_config
from ._env import ShieldedEnv
from ._shield import Decision, Shield

__all__ = ["ConfigError", "Decision", "Shield", "ShieldError", "ShieldedEnv", "__version__", "usual_config"]
