"""A finished build plan as geometry: what the page and the picture both draw.

World frame, z up [m]. Number 0 is the first block, number ``n`` the block of step ``n``; the
same numbers stand on the blocks in every drawing and in the table of steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.viewer.playback import rotation_of
from learn2assemble.world.blocks import RELATIONS

FORMAT, VERSIONS = "learn2assemble-plan", (1, 2)
STATUSES = ("complete", "incomplete", "refused")
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_TOLERANCE = 0.002
"""Blocks this close to each other [m] count as touching; a robot places within a millimetre."""


@dataclass(frozen=True)
class Placed:
    """One block of the structure."""

    number: int
    """0 for the first block, else the step that places it."""
    waiting: int | None
    """Index of its waiting place; None for the first block."""
    position: np.ndarray
    """float64[3]: centre [m, world]."""
    quaternion: np.ndarray
    """float64[4]: unit orientation (w, x, y, z)."""
    outside: bool
    """Stands outside every outline: a support."""
    step: Mapping[str, Any]
    """The entry of ``steps`` in the plan; empty for the first block."""

    @property
    def rotation(self) -> np.ndarray:
        """R_world_block, float64[3, 3]."""
        return rotation_of(self.quaternion)

    def corners(self, edge: float) -> np.ndarray:
        """float64[8, 3] [m, world]."""
        return self.position + (edge / 2 * _CORNERS) @ self.rotation.T


@dataclass(frozen=True)
class Elevation:
    """One side of the target. Its local frame: x right, y away from the viewer, z up."""

    name: str
    frame: np.ndarray
    """float64[4]: (cos, sin, t_x, t_y) of p_world = R_z p_local + t (protocol 1.2)."""
    outline: np.ndarray
    """float64[V, 2]: local (x, z) [m] in the face plane."""

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """World points to local points, ``float64[..., 3]`` [m]."""
        c, s, tx, ty = self.frame
        x, y = points[..., 0] - tx, points[..., 1] - ty
        return np.stack([c * x + s * y, c * y - s * x, points[..., 2]], -1)

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Local points to world points, ``float64[..., 3]`` [m]."""
        c, s, tx, ty = self.frame
        x, y = points[..., 0], points[..., 1]
        return np.stack([c * x - s * y + tx, s * x + c * y + ty, points[..., 2]], -1)

    def face(self, edge: float) -> np.ndarray:
        """The outline in the face plane ``y = -edge / 2``: float64[V, 3] [m, world]."""
        x, z = self.outline.T
        return self.to_world(np.stack([x, np.full_like(x, -edge / 2), z], -1))


@dataclass(frozen=True)
class Seen:
    """A block as one side sees it: its shadow on the face plane and how deep it stands."""

    number: int
    polygon: np.ndarray
    """float64[K, 2]: convex, local (x, z) [m]."""
    centre: np.ndarray
    """float64[2]: local (x, z) [m]."""
    layer: str
    """``front`` of the face plane, in the ``face`` row of blocks, or ``behind`` it."""


@dataclass(frozen=True)
class Scene:
    """Everything that is drawn of one plan."""

    edge: float
    """Edge of a block [m]."""
    blocks: tuple[Placed, ...]
    """In order of placement, the first block first."""
    elevations: tuple[Elevation, ...]
    waiting: np.ndarray
    """float64[W, 3]: where the blocks wait in the drawings [m, world]."""
    first: int | None
    """Row of ``waiting`` that is the first block itself, which never waits."""
    rearranged: bool
    """The plan's waiting places cannot be drawn as they are, so a tray is drawn instead."""

    @property
    def num_steps(self) -> int:
        """Blocks placed after the first."""
        return max((block.number for block in self.blocks), default=0)

    def seen_from(self, side: int) -> tuple[Seen, ...]:
        """What side ``side`` sees, farthest first (painter's order)."""
        elevation, seen = self.elevations[side], []
        for block in self.blocks:
            x, y, z = elevation.to_local(block.position)
            layer = "face" if abs(y) < self.edge / 2 else "front" if y < 0 else "behind"
            corners = elevation.to_local(block.corners(self.edge))[:, [0, 2]]
            seen.append((-y, Seen(block.number, hull(corners), np.array([x, z]), layer)))
        return tuple(item for _, item in sorted(seen, key=lambda pair: pair[0]))


def read_scene(plan: Mapping[str, Any]) -> Scene:
    """The geometry of a parsed ``plan.json``.

    Raises:
        InputError: for something that is not such a plan.
        UnknownNameError: for a status or relation that does not exist.
    """
    if plan.get("format") != FORMAT or plan.get("version") not in VERSIONS:
        got = f"{plan.get('format')} version {plan.get('version')}"
        raise InputError("plan", got, f"{FORMAT} version 1 or 2")
    if plan.get("status") not in STATUSES:
        raise UnknownNameError("plan status", plan.get("status"), STATUSES)
    try:
        return _read(plan)
    except KeyError as error:
        raise InputError("plan", f"no field {error}", f"a {FORMAT} file") from None
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError("plan", str(error), f"a {FORMAT} file") from None


def _read(plan: Mapping[str, Any]) -> Scene:
    design = plan["design"]
    edge = float(design["block_edge"])
    if not 0 < edge < math.inf:
        raise InputError("design.block_edge", edge, "a positive length in metres")
    frames = _numbers("design.frames", design["frames"], 4)
    if len(frames) != len(design["elevations"]) or not len(frames):
        raise InputError("design.frames", len(frames), f"{len(design['elevations'])} elevations")
    elevations = tuple(
        Elevation(str(item["name"]), frame, _numbers(f"outline {i + 1}", item["outline"], 2))
        for i, (item, frame) in enumerate(zip(design["elevations"], frames, strict=True))
    )
    waiting = _numbers("blocks.waiting", plan["blocks"]["waiting"], 3)
    blocks = _blocks(plan, len(waiting))
    first = _first_row(plan, waiting, blocks, edge)
    rows = [row for row in range(len(waiting)) if row != first]
    drawn = waiting.copy()
    rearranged = _needs_tray(waiting[rows], blocks, edge)
    if rearranged:
        drawn[rows] = _tray(len(rows), blocks, edge)
    return Scene(edge, blocks, elevations, drawn, first, rearranged)


def _first_row(
    plan: Mapping[str, Any], waiting: np.ndarray, blocks: tuple[Placed, ...], edge: float
) -> int | None:
    """The row of ``waiting`` where the first block already stands, if it has one."""
    if not plan.get("first_block"):
        return None
    row = int(plan["first_block"]["block"])
    if not 0 <= row < len(waiting) or row in {block.waiting for block in blocks}:
        return None
    near = bool(np.abs(waiting[row] - blocks[0].position).max() < edge / 2)
    return row if near else None


def _blocks(plan: Mapping[str, Any], num_waiting: int) -> tuple[Placed, ...]:
    first, blocks = plan.get("first_block"), []
    if first:
        blocks.append(_placed(0, None, first, {}))
    for number, step in enumerate(plan["steps"], 1):
        where = f"steps[{number - 1}]"
        if step["step"] != number:
            raise InputError(f"{where}.step", step["step"], str(number))
        if step["relation"] not in RELATIONS:
            raise UnknownNameError(f"{where}.relation", step["relation"], RELATIONS)
        if not 0 <= step["reference"] < number:
            raise InputError(f"{where}.reference", step["reference"], f"0 to {number - 1}")
        if not 0 <= step["block"] < num_waiting:
            raise InputError(f"{where}.block", step["block"], f"0 to {num_waiting - 1}")
        blocks.append(_placed(number, int(step["block"]), step, step))
    return tuple(blocks)


def _placed(
    number: int, waiting: int | None, pose: Mapping[str, Any], step: Mapping[str, Any]
) -> Placed:
    position = _numbers(f"position of block {number}", [pose["position"]], 3)[0]
    quaternion = _numbers(f"quaternion of block {number}", [pose["quaternion"]], 4)[0]
    norm = float(np.linalg.norm(quaternion))
    if norm < 1e-6:
        raise InputError(f"quaternion of block {number}", pose["quaternion"], "w, x, y, z")
    outside = bool(step.get("outside", False))
    return Placed(number, waiting, position, quaternion / norm, outside, step)


def _numbers(what: str, rows: Any, width: int) -> np.ndarray:
    """``rows`` as float64[n, width], finite."""
    if not len(rows):
        return np.zeros((0, width))
    array = np.asarray(rows, np.float64)
    if array.ndim != 2 or array.shape[1] != width or not np.isfinite(array).all():
        raise InputError(what, rows, f"rows of {width} finite numbers")
    return array


def _needs_tray(waiting: np.ndarray, blocks: tuple[Placed, ...], edge: float) -> bool:
    """Whether the waiting places cannot be drawn as planned.

    Without a robot they are node positions, not bodies (protocol 1.4): they may overlap, sink
    into the table or hide the structure.
    """
    if not len(waiting):
        return False
    built = np.array([block.position for block in blocks]).reshape(-1, 3)
    return bool(
        np.any(waiting[:, 2] < edge / 2 - _TOLERANCE)
        or np.any(np.ptp(waiting, axis=0) > 24 * edge)
        or _touch(waiting, waiting, edge) > len(waiting)
        or _touch(waiting, built, 2 * edge) > 0
    )


def _tray(count: int, blocks: tuple[Placed, ...], edge: float) -> np.ndarray:
    """Rows of waiting blocks in front of side 1: float64[count, 3] [m, world]."""
    built = np.array([block.position for block in blocks]).reshape(-1, 3)
    columns = max(math.ceil(math.sqrt(2.6 * count)), 1)
    pitch = 1.4 * edge
    row, column = np.divmod(np.arange(count), columns)
    in_row = np.minimum(count - row * columns, columns)
    front = built[:, 1].min() if len(built) else 0.0
    middle = (built[:, 0].min() + built[:, 0].max()) / 2 if len(built) else 0.0
    x = middle + (column - (in_row - 1) / 2) * pitch
    return np.stack([x, front - 3 * edge - row * pitch, np.full(count, edge / 2)], -1)


def _touch(these: np.ndarray, those: np.ndarray, distance: float) -> int:
    """Pairs nearer than ``distance`` [m] along every axis."""
    gap = np.abs(these[:, None] - those[None]).max(-1, initial=0.0)
    return int((gap < distance - _TOLERANCE).sum())


def hull(points: np.ndarray) -> np.ndarray:
    """Convex hull of float64[n, 2] in counter-clockwise order (monotone chain).

    Corners within a micrometre of an edge are left out.
    """
    ordered = sorted({(round(x, 6), round(y, 6)) for x, y in points.tolist()})
    if len(ordered) < 3:
        return np.array(ordered)

    def chain(items: list[tuple[float, float]]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for p in items:
            while len(out) > 1 and _turn(out[-2], out[-1], p) <= 1e-9:
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the signed area of the triangle a b c: positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
