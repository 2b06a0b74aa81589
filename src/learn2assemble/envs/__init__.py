"""Gymnasium environments: single and native vectorised, registered over the tasks.

Thin skins over :class:`learn2assemble.tasks.simulator.Simulator`: no rule of the world lives here.
Importing this package only registers ``learn2assemble/<task>-v0``; the environments load when one
is made. It needs the extra ``learn``.

Gymnasium 1.0 removed its entry points for plug-ins, so environments are registered when their
module is imported: ``import learn2assemble.envs``, which ``gymnasium.register_envs`` shows to be
used, and ``gymnasium.make("learn2assemble/<task>-v0")``.
"""

from __future__ import annotations

from typing import Any

from learn2assemble.errors import extra
from learn2assemble.registry import Registry
from learn2assemble.tasks.task import DESIGN_TASKS, GOAL_TASKS, HIDDEN_TASKS, PRESETS, get_task

with extra("gymnasium", "learn"):
    import gymnasium
    from gymnasium.envs.registration import registry

__all__ = ["NAMESPACE", "VERSION", "env_id", "register_all"]

NAMESPACE = "learn2assemble"
VERSION = 0
"""Raised when the behaviour of the environments changes."""


def env_id(task_name: str) -> str:
    """The Gymnasium id of a task.

    Raises:
        UnknownNameError: naming the nearest task.
    """
    known = any(task_name in tasks for tasks in (DESIGN_TASKS, GOAL_TASKS, HIDDEN_TASKS))
    name = task_name if known else get_task(task_name).name
    return f"{NAMESPACE}/{name}-v{VERSION}"


def register_all() -> None:
    """Register every task that is not registered yet, and from now on every new one.

    The passive checker is off because a test runs Gymnasium's full checker over every preset;
    ``gymnasium.make(..., disable_env_checker=False)`` turns it on.
    """
    for tasks, _ in _ENVIRONMENTS:
        for name in tasks:
            _register(name)
        if _register not in tasks.listeners:
            tasks.listeners.append(_register)


def _register(name: str) -> None:
    environment = f"{NAMESPACE}/{name}-v{VERSION}"
    if environment not in registry:
        points = next(points for tasks, points in _ENVIRONMENTS if name in tasks)
        library: Any = gymnasium  # Its types are known in part.
        library.register(environment, disable_env_checker=True, kwargs={"task": name}, **points)


_ENVIRONMENTS: tuple[tuple[Registry[Any], dict[str, Any]], ...] = (
    (
        PRESETS,
        {
            "entry_point": "learn2assemble.envs.assembly:AssemblyEnv",
            "vector_entry_point": "learn2assemble.envs.assembly:AssemblyVectorEnv",
        },
    ),
    (DESIGN_TASKS, {"entry_point": "learn2assemble.envs.designs:DesignEnv"}),
    (GOAL_TASKS, {"entry_point": "learn2assemble.envs.designs:GoalsEnv"}),
    (HIDDEN_TASKS, {"entry_point": "learn2assemble.envs.hidden:HiddenEnv"}),
)
"""Which environment plays the tasks of each table."""


register_all()
