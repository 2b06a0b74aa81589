"""The learned builder of designs: network, search, training; it plugs in as a planner, a player and
a policy of the benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn2assemble.errors import InputError
from learn2assemble.files import check_exists

if TYPE_CHECKING:
    from collections.abc import Callable

    from l2a_lab.builder.tasks import TaskPlayer
    from learn2assemble.assembly.kit import Kit
    from learn2assemble.design.cells import CellDesign
    from learn2assemble.envs.suite import Choose
    from learn2assemble.planning.plan import Plan
    from learn2assemble.planning.tiling.planners import (
        Chosen,
        PlanLimits,
        Planner,
        PlannerChoice,
        Progress,
    )
    from learn2assemble.registry import Registry
    from learn2assemble.tasks.evaluation.episodes import PlayerKind


class LearnedBuilder:
    """Implements :class:`learn2assemble.planning.tiling.planners.Planner` with a network and its
    search."""

    def carry_out(self, *given: Any) -> Plan:
        from l2a_lab.builder.arm import build_by_arm

        return build_by_arm(*given)

    def resolve_agent(self, agent: object) -> str:
        from l2a_lab.builder.network import DEFAULT, is_builder

        if isinstance(agent, str | Path):
            if Path(agent).suffix == ".safetensors":
                check_exists(Path(agent), f"file of a builder, or a name such as {DEFAULT}")
            if is_builder(str(agent)):
                return str(agent)
        name = getattr(agent, "name", str(agent))
        raise InputError(
            "agent", name, f"a builder of designs such as {DEFAULT} (others play tasks)"
        )

    def choose(
        self,
        design: CellDesign,
        kit: Kit,
        limits: PlanLimits,
        choice: PlannerChoice,
        progress: Progress,
    ) -> Chosen:
        from l2a_lab.builder.planner import plan_with_agent
        from learn2assemble.planning.tiling.planners import Chosen

        return Chosen(*plan_with_agent(design.wanted, kit, limits, choice))


class Builders:
    """Implements :class:`learn2assemble.tasks.evaluation.episodes.PlayerKind`: builders of designs
    that play tasks."""

    def knows(self, name_or_path: str) -> bool:
        from l2a_lab.builder.network import is_builder

        return is_builder(name_or_path)

    def load(self, name_or_path: str | Path) -> TaskPlayer:
        from l2a_lab.builder.network import load_builder
        from l2a_lab.builder.tasks import TaskPlayer

        return TaskPlayer(load_builder(name_or_path))


def register_planner(table: Registry[Planner]) -> None:
    """Add the learned builder to the planners of designs."""
    table.register("agent", LearnedBuilder())


def register_player(table: Registry[PlayerKind]) -> None:
    """Add builders to what plays tasks."""
    table.register("builder", Builders())


def register_policy(table: Registry[Callable[[str], Choose]]) -> None:
    """Add builders to the policies of the benchmark."""
    from l2a_lab.builder.policy import GreedyBuilder, SearchingBuilder

    table.register("builder", GreedyBuilder)
    table.register("builder-with-search", SearchingBuilder)
