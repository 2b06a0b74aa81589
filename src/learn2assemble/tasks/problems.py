"""Tasks as problems that can be built by their name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from learn2assemble.tasks.task import PRESETS, get_task

if TYPE_CHECKING:
    from learn2assemble.jobs.problems import ProblemFamily
    from learn2assemble.planning.plan import Plan
    from learn2assemble.registry import Registry


class TaskProblem(NamedTuple):
    """Implements :class:`learn2assemble.jobs.problems.ProblemFamily` for a task."""

    name: str

    def has_arm(self, arm: str | None) -> bool:
        return get_task(self.name, arm).has_arm

    def build(self, **how: Any) -> Plan:
        from learn2assemble.tasks.episode import build_task

        return build_task(self.name, **how)


def register_problem(table: Registry[ProblemFamily]) -> None:
    """Add every task there is, and every one that a user adds later."""

    def add(name: str) -> None:
        table.register(name, TaskProblem(name), replace=True)

    for name in PRESETS:
        add(name)
    PRESETS.listeners.append(add)
