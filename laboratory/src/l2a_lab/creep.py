"""How far the blocks of an exported MuJoCo model get from their places: ``results/designs.json``.

A model that is exact stays where it is; what is measured is what the simulation adds, by contacts
that give and friction that creeps.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from l2a_lab import shapes
from l2a_lab.states import largest_move, states_of
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import to_assembly

SECONDS = 20.0
"""Of every simulation."""
LIMIT = 1e-4
"""How far a block may get [m]."""
GAPS = (1e-4, 0.0)
"""Widths of vertical joints [m]."""


class Case(NamedTuple):
    """A structure that is simulated."""

    kit: str
    make: Callable[[], np.ndarray]
    """Its cells."""
    props: bool = False
    """The state with the most props is simulated, not the finished structure."""


def _drawn(name: str) -> Callable[[], np.ndarray]:
    def make() -> np.ndarray:
        path = Path("examples/designs") / name
        design = read_design(path, cell=load_kit("bricks-lintels").pitch)
        assert isinstance(design, CellDesign)
        return design.wanted

    return make


CASES: dict[str, Case] = {
    "gate.svg": Case("bricks-lintels", _drawn("gate.svg")),
    "arch.svg": Case("bricks-lintels", _drawn("arch.svg")),
    "stepped_tower.json": Case("bricks-lintels", _drawn("stepped_tower.json")),
    "wall of 12 x 1 x 6 cells": Case("bricks", lambda: np.ones((12, 1, 6), bool)),
    "block of 4 x 2 x 4 cells": Case("tetrominoes", lambda: np.ones((4, 2, 4), bool)),
    "bridge": Case("bricks-lintels", lambda: shapes.bridge(1, 5, 2, 2, 1, 1)),
    "long bridge on its props": Case("bricks-lintels", shapes.SHAPES["bridge-long"], props=True),
    "long bridge, its props removed": Case("bricks-lintels", shapes.SHAPES["bridge-long"]),
    "blob on its props": Case("bricks-lintels", shapes.SHAPES["blob-2"], props=True),
}


def structure(name: str, gap: float) -> Assembly:
    """The blocks that are simulated, of a case by its name with vertical joints of a width [m]."""
    case = CASES[name]
    kit = load_kit(case.kit)
    tiling, ordering = plan_exact(case.make(), kit)
    assert ordering is not None, name
    assembly = to_assembly(tiling, ordering, kit, gap=gap)
    if not case.props:
        return assembly.finished
    return max(
        states_of(assembly), key=lambda made: sum(b.id.startswith("prop") for b in made.blocks)
    )


def entry(name: str) -> dict[str, Any]:
    """The largest move of a case for every width of its joints."""
    made = {gap: structure(name, gap) for gap in GAPS}
    return {
        "seconds": SECONDS,
        "blocks": len(made[GAPS[0]].blocks),
        "props": sum(b.id.startswith("prop") for b in made[GAPS[0]].blocks),
        "largest_move_m": {f"{gap:g}": round(largest_move(made[gap], SECONDS), 6) for gap in GAPS},
    }
