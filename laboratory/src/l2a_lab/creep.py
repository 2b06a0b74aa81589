"""How far the blocks of an exported MuJoCo model get from their places: ``results/designs.json``.

A model that is exact stays where it is; what is measured is what the simulation adds, by contacts
that give and friction that creeps.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from l2a_lab import shapes
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.kit import load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.export.formats import mjcf
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import to_assembly

SECONDS = 20.0
"""Of every simulation."""
LIMIT = 1e-4
"""How far a block may get [m]."""
GAPS = (1e-4, 0.0)
"""Widths of vertical joints [m]."""
EVERY = 10
"""Steps of the simulation between two looks at where the blocks are."""


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
    standing = [standing_after(assembly, count) for count in range(1, len(assembly.steps) + 1)]
    return max(standing, key=lambda made: sum(b.id.startswith("prop") for b in made.blocks))


def standing_after(assembly: Assembly, count: int) -> Assembly:
    """What stands after so many steps, as a finished structure: props are blocks like others."""
    present: dict[str, None] = {}
    for step in assembly.steps[:count]:
        if step.action == "place":
            present[step.block] = None
        elif step.action == "remove":
            del present[step.block]
    blocks = tuple(
        replace(block, prop=False)
        for block in assembly.blocks
        if block.id in present or block.support
    )
    return replace(assembly, blocks=blocks, steps=())


def largest_move(assembly: Assembly, seconds: float = SECONDS, ground: bool = False) -> float:
    """Largest distance of any block of the finished structure from its place, at any time of a
    simulation of its MuJoCo model [m].

    Args:
        assembly: blocks where they stand.
        seconds: of the simulation.
        ground: z = 0 is one beside blocks that are supports, too, as those that are held.
    """
    import mujoco

    made = ElementTree.fromstring(mjcf(assembly))
    world = made.find("worldbody")
    assert world is not None
    if ground and world.find("geom[@name='table']") is None:
        # The first geom, where models of blocks on the ground have it.
        plane = ElementTree.Element("geom", name="table", type="plane", size="0 0 0.05")
        world.insert(1, plane)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(made, encoding="unicode"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before, worst = data.xpos.copy(), 0.0
    for step in range(1, int(seconds / model.opt.timestep) + 1):
        mujoco.mj_step(model, data)
        if step % EVERY == 0:
            worst = max(worst, float(np.linalg.norm(data.xpos - before, axis=1).max()))
    return worst


def entry(name: str) -> dict[str, Any]:
    """The largest move of a case for every width of its joints."""
    made = {gap: structure(name, gap) for gap in GAPS}
    return {
        "seconds": SECONDS,
        "blocks": len(made[GAPS[0]].blocks),
        "props": sum(b.id.startswith("prop") for b in made[GAPS[0]].blocks),
        "largest_move_m": {f"{gap:g}": round(largest_move(made[gap]), 6) for gap in GAPS},
    }
