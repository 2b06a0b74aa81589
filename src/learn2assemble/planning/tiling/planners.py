"""Who chooses blocks of a kit for the cells of a design, and their order: planners by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from learn2assemble.errors import InputError
from learn2assemble.registry import Registry, add_plugin

if TYPE_CHECKING:
    import numpy as np

    from learn2assemble.assembly.kit import Kit
    from learn2assemble.planning.plan import SearchReport
    from learn2assemble.planning.tiling.ordering import Ordering
    from learn2assemble.planning.tiling.tile import Tiling

Progress = Callable[[str], None]


class Chosen(NamedTuple):
    """What a planner answers."""

    tiling: Tiling
    ordering: Ordering | None
    search: SearchReport | None = None
    """What its search took."""
    agent: str | None = None
    """Name of the agent that chose."""


class Planner(Protocol):
    """Chooses blocks and their order."""

    @property
    def carry_out(self) -> Callable[..., Any] | None:
        """How an arm carries out what it plans, ``(plan_with, wanted, kit, workcell, progress)``;
        None: like any plan."""
        ...

    def resolve_agent(self, agent: object) -> str:
        """The name or file of an agent that it takes.

        Raises:
            InputError: for what is none.
        """
        ...

    def choose(
        self, wanted: np.ndarray, kit: Kit, *, seconds: float, progress: Progress, **how: Any
    ) -> Chosen:
        """Blocks of ``kit`` that fill ``wanted``, and an order in which every state is proven.

        Args:
            wanted: bool[X, Y, Z].
            kit: with blocks as large as the cells.
            seconds: limit of planning and proof.
            progress: called with a line of text.
            how: ``friction``, ``gap``, ``props``, ``shades``, ``agent``, ``seed``, ``hand``.
        """
        ...


class ExactPlanner:
    """The exact planner (:mod:`.tiling.exact`), and advice where it finds nothing."""

    carry_out = None

    def resolve_agent(self, agent: object) -> str:
        raise InputError("agent", str(agent), "none with the exact planner")

    def choose(
        self, wanted: np.ndarray, kit: Kit, *, seconds: float, progress: Progress, **how: Any
    ) -> Chosen:
        from learn2assemble.planning.tiling.advice import advised_exact

        return Chosen(
            *advised_exact(
                wanted,
                kit,
                seconds=seconds,
                progress=progress,
                friction=how["friction"],
                gap=how["gap"],
                props_allowed=how["props"],
                shades=how["shades"],
            )
        )


PLANNERS: Registry[Planner] = Registry("planner", {"exact": ExactPlanner()})
"""Every planner by name; the laboratory adds its own where it is installed."""
add_plugin("l2a_lab.builder", "planner", optional=True)
