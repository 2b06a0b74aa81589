"""Names of what is no design, each with who makes a problem of it and builds that.

The tasks of the paper enter themselves, so that nothing between a design and a robot needs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from learn2assemble.registry import Registry, add_plugin

if TYPE_CHECKING:
    from learn2assemble.planning.plan import Plan

NO_ARM = "none"
"""Instead of the name of an arm: nothing carries the blocks."""


class ProblemFamily(Protocol):
    """A family of random problems."""

    def has_arm(self, arm: str | None) -> bool:
        """Whether an arm builds them, where ``arm`` is asked for."""
        ...

    def build(
        self, *, arm: str | None, agent: Any, seed: int, seconds: float, progress: Any
    ) -> Plan:
        """The plan of a random problem; arguments of :func:`learn2assemble.jobs.build.build`."""
        ...


PROBLEMS: Registry[ProblemFamily] = Registry("problem", {})
"""Every family by name."""
add_plugin("learn2assemble.tasks.problems", "problem")
