"""One registration over all presets: ``learn2assemble/<preset>-v0``.

Gymnasium 1.0 removed its plugin entry points, so a package registers when it is imported:
``import learn2assemble`` and ``gymnasium.make("learn2assemble/<preset>-v0")``, or in one go
``gymnasium.make("learn2assemble:learn2assemble/<preset>-v0")``.
"""

from __future__ import annotations

import gymnasium
from gymnasium.envs.registration import registry

from learn2assemble.tasks import PRESETS, get_task

NAMESPACE = "learn2assemble"
VERSION = 0
"""Raised when the behaviour of the environments changes."""


def env_id(task_name: str) -> str:
    """The Gymnasium id of a preset.

    Raises:
        UnknownNameError: naming the nearest preset.
    """
    return f"{NAMESPACE}/{get_task(task_name).name}-v{VERSION}"


def register_all() -> None:
    """Register every preset that is not registered yet (calling it twice is harmless).

    The passive checker is off because a test runs Gymnasium's full checker over every preset;
    ``gymnasium.make(..., disable_env_checker=False)`` turns it on.
    """
    for name in PRESETS:
        if env_id(name) in registry:
            continue
        gymnasium.register(
            env_id(name),
            entry_point="learn2assemble.envs.single:AssemblyEnv",
            vector_entry_point="learn2assemble.envs.vector:AssemblyVectorEnv",
            disable_env_checker=True,
            kwargs={"task": name},
        )


register_all()
