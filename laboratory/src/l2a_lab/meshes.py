"""Meshes built of bricks that clutch, measured: bodies as files, tiling, order and proof."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import learn2assemble as l2a
from l2a_lab.measured import Result, table_lines
from learn2assemble.assembly.files import read_assembly
from learn2assemble.export.formats import export_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.statics.rigid_blocks import check

SECONDS = 600.0
"""Limit of a plan."""


class MeshCase(NamedTuple):
    """A mesh, how finely it is built, and what is asked."""

    make: Callable[[], Any]
    """The mesh, of :mod:`trimesh`, upright."""
    wide: int
    """Studs."""
    shell: int | None
    seconds: float
    """Asked, of the processor, from the file of the mesh to all files of the plan."""


def _library() -> Any:
    """:mod:`trimesh`, whose types are incomplete."""
    import trimesh

    return trimesh


def ball() -> Any:
    """A ball of radius 1."""
    return _library().creation.icosphere(subdivisions=4)


def ring() -> Any:
    """A torus that lies, of radii 1 and 0.42."""
    return _library().creation.torus(1.0, 0.42, major_sections=96, minor_sections=48)


def jug() -> Any:
    """A jug with a belly, a neck, a spout and a handle: of one surface."""
    library = _library()
    radius = [0.0, 0.62, 0.95, 1.08, 1.0, 0.74, 0.52, 0.46, 0.5, 0.62, 0.0]
    height = [0.0, 0.0, 0.35, 0.85, 1.3, 1.75, 2.0, 2.25, 2.5, 2.7, 2.7]
    body = library.creation.revolve(np.column_stack([radius, height]), sections=96)
    handle = library.creation.torus(0.55, 0.16, major_sections=64, minor_sections=24)
    handle.apply_transform(library.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    handle.apply_translation((0.85, 0.0, 1.8))
    return library.boolean.union([body, handle])


def snail() -> Any:
    """A figure of our own: a snail, its shell of a coil that winds out, on a long foot."""
    library = _library()

    def blob(at: tuple[float, float, float], size: tuple[float, float, float]) -> Any:
        made = library.creation.icosphere(subdivisions=3)
        made.apply_scale(size)
        made.apply_translation(at)
        return made

    turns = np.linspace(0.0, 3.2 * np.pi, 26)
    coil = [
        blob(
            (-0.35 + 0.28 * t / np.pi * np.cos(t) / 1.1, 0.0, 1.35 + 0.28 * t / np.pi * np.sin(t)),
            (0.22 + 0.035 * t, 0.3 + 0.03 * t, 0.22 + 0.035 * t),
        )
        for t in turns
    ]
    foot = [blob((x, 0.0, 0.28), (0.5, 0.42, 0.28)) for x in np.linspace(-1.7, 1.5, 9)]
    foot.append(library.creation.box(bounds=[(-1.9, -0.4, 0.0), (1.7, 0.4, 0.3)]))
    neck = [blob((1.5 + 0.12 * k, 0.0, 0.4 + 0.2 * k), (0.42, 0.36, 0.36)) for k in range(5)]
    horn = library.creation.revolve([(0.0, 0.0), (0.13, 0.0), (0.13, 0.5), (0.0, 0.5)], sections=24)
    horns: list[Any] = []
    for side in (-1, 1):
        one = horn.copy()
        one.apply_transform(library.transformations.rotation_matrix(0.25 * side, (1, 0, 0)))
        one.apply_translation((2.05, -0.16 * side, 1.3))
        horns.append(one)
    return library.boolean.union([*coil, *foot, *neck, *horns])


MESHES: dict[str, MeshCase] = {
    "ring, 24 studs": MeshCase(ring, 24, None, 30.0),
    "ball, 24 studs, hollow": MeshCase(ball, 24, 2, 30.0),
    "jug, 24 studs, hollow": MeshCase(jug, 24, 2, 30.0),
    "snail, 24 studs": MeshCase(snail, 24, None, 30.0),
    "ring, 48 studs": MeshCase(ring, 48, None, 240.0),
    "ball, 48 studs, hollow": MeshCase(ball, 48, 2, 240.0),
    "jug, 48 studs, hollow": MeshCase(jug, 48, 2, 240.0),
    "snail, 48 studs, hollow": MeshCase(snail, 48, 2, 240.0),
}


@cache
def _warm() -> None:
    """Fill and order something small, which loads and compiles what that uses."""
    wanted = np.zeros((4, 4, 3), bool)
    wanted[:, :, 1] = wanted[0, 0] = True
    l2a.build(wanted, kit="lego", hands=True)


def mesh_entry(name: str) -> Result:
    """A mesh from its file to the files of a proven plan, with hands, kit ``lego``."""
    case = MESHES[name]
    _warm()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mesh.stl"
        case.make().export(file)
        started = time.process_time()
        plan: Plan = l2a.build(
            file,
            kit="lego",
            cells_wide=case.wide,
            shell=case.shell,
            hands=True,
            seconds=SECONDS,
        )
        plan.save(Path(folder) / "plan")
        seconds = time.process_time() - started
        made = plan.assembly
        assert made is not None
        export_assembly(made, "ldraw", Path(folder) / "model.ldr")
        lines = (Path(folder) / "model.ldr").read_text().splitlines()
        started = time.process_time()
        found = check(read_assembly(Path(folder) / "model.ldr", kit="lego"))
        checked = time.process_time() - started
    ways = [step.way for step in made.steps if step.action == "place"]
    return {
        "status": plan.status,
        "reason": plan.reason or "",
        "bricks": len(made.blocks),
        "placed": plan.blocks.used,
        "common": plan.design.iou,
        "seconds": round(seconds, 3),
        "seconds_asked": case.seconds,
        "holds": sum(step.action == "hold" for step in made.steps),
        "from_below": ways.count("below"),
        "beside": ways.count("beside"),
        "ldraw_steps": lines.count("0 STEP"),
        "check_seconds": round(checked, 3),
        "check_verdict": found.verdict,
        "check_margin_n": found.margin_n,
    }


def mesh_rows(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    for name, one in entries.items():
        got = (
            f"{one['seconds']:.1f} s, {one['status']}: {one['placed']} of {one['bricks']} bricks, "
            f"{one['holds']} holds; check {one['check_seconds']:.1f} s"
        )
        rows.append((f"mesh: {name}", f"<= {one['seconds_asked']:g} s", got))
    return rows


def mesh_table(entries: dict[str, Result]) -> str:
    """What was reached, as the table of ``docs/bricks.md``."""
    head = ["mesh, with hands", "bricks", "processor time", "asked", "holds", "`check`"]
    rows: list[list[str]] = []
    for name in MESHES:
        one = entries[f"mesh/{name}"]
        told = [
            name,
            f"{one['placed']:,}" if one["status"] == "complete" else one["status"],
            f"{one['seconds']:.0f} s",
            f"{one['seconds_asked']:.0f} s",
            f"{one['holds']:,}",
            f"{one['check_seconds']:.1f} s",
        ]
        rows.append(told)
    return "\n".join(table_lines(head, rows)) + "\n"
