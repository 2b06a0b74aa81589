"""Who chooses blocks of a kit for the cells of a design, and their order: planners by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from learn2assemble.errors import InputError
from learn2assemble.registry import Registry, add_plugin

if TYPE_CHECKING:
    from learn2assemble.assembly.kit import Kit
    from learn2assemble.design.cells import CellDesign
    from learn2assemble.planning.plan import SearchReport
    from learn2assemble.planning.tiling.cover.tile import Tiling
    from learn2assemble.planning.tiling.ordering import Ordering
    from learn2assemble.statics.proofs import Bounds

EXACT = "exact"
Progress = Callable[[str], None]


@dataclass(frozen=True)
class PlanLimits:
    """What a plan is held to."""

    friction: Bounds = None
    """Coulomb coefficient, or the range to prove every step for; None: that of the kit."""
    gap: Bounds = None
    """Width of vertical joints [m], or the range to prove every step for; None: that of the
    kit."""
    props: bool = True
    """Whether temporary blocks may be used."""
    seconds: float = 60.0
    """Wall-clock limit of planning and proof."""


@dataclass(frozen=True)
class PlannerChoice:
    """Who plans."""

    name: str = EXACT
    """As in :data:`PLANNERS`."""
    agent: object = None
    """Of a planner that has some: itself, or its name or file."""
    seed: int = 0
    """Of its search."""
    hand: Any = None
    """An arm that makes the placements, for a planner that asks it."""


BY_EXACT = PlannerChoice()


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
        self,
        design: CellDesign,
        kit: Kit,
        limits: PlanLimits,
        choice: PlannerChoice,
        progress: Progress,
    ) -> Chosen:
        """Blocks of ``kit`` that fill the cells of a design, and an order in which every state is
        proven.

        Args:
            kit: with blocks as large as the cells.
            choice: of this planner, with what it needs.
            progress: called with a line of text.
        """
        ...


class ExactPlanner:
    """The exact planner (:mod:`.tiling.exact`), and advice where it finds nothing."""

    carry_out = None

    def resolve_agent(self, agent: object) -> str:
        raise InputError("agent", str(agent), "none with the exact planner")

    def choose(
        self,
        design: CellDesign,
        kit: Kit,
        limits: PlanLimits,
        choice: PlannerChoice,
        progress: Progress,
    ) -> Chosen:
        from learn2assemble.planning.tiling.advice import advised_exact

        return Chosen(
            *advised_exact(
                design.wanted,
                kit,
                seconds=limits.seconds,
                progress=progress,
                friction=limits.friction,
                gap=limits.gap,
                props_allowed=limits.props,
                shades=design.shades,
            )
        )


PLANNERS: Registry[Planner] = Registry("planner", {EXACT: ExactPlanner()})
"""Every planner by name; the laboratory adds its own where it is installed."""
add_plugin("l2a_lab.builder", "planner", optional=True)
