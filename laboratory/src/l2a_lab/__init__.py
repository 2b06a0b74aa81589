"""The paper's laboratory: tables, bounds, recordings, the published cell, recipes of the agents.

It plugs into the product's tables of names; nothing in the product imports it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from learn2assemble.registry import Registry
    from learn2assemble.tasks.physics.protocol import Physics
    from learn2assemble.tasks.search.tree import SearchModel
    from learn2assemble.tasks.task import Task
    from learn2assemble.tasks.world_model import WorldModel


def register_physics(table: Registry[Callable[[Task], Physics]]) -> None:
    """Add the published cell to the placement checkers."""
    table.register("published", _published)


def register_search_model(table: Registry[Callable[[WorldModel], SearchModel]]) -> None:
    """Add the search in copies with the published restore faults."""
    from l2a_lab.restore_faults import with_restore_faults

    table.register("published", with_restore_faults)


def _published(task: Task) -> Physics:
    # MuJoCo is loaded only by those who ask for it.
    from l2a_lab.bullet.cell import published_physics

    return published_physics(task)
