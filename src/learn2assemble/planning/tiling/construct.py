"""Exact planning: a design of cells becomes blocks of a kit, an order, and a proof of every step.

Nothing here is learned: :mod:`.tiling` chooses the blocks, :mod:`.ordering` the order, and what is
called complete fills every wanted cell and no other.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.kit import DEFAULT_KIT, Cell, Kit, load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.planning import plan as plans
from learn2assemble.planning.plan import Plan, PlanDesign, Step
from learn2assemble.planning.tiling.cover.candidates import placement_cells, strange_cells
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.ordering import Ordering, to_assembly
from learn2assemble.planning.tiling.planners import (
    BY_EXACT,
    EXACT,
    PLANNERS,
    PlanLimits,
    PlannerChoice,
)
from learn2assemble.statics.proofs import TIGHT, Bounds, widest_joint
from learn2assemble.values import rounded


def plan_cells(
    design: CellDesign,
    kit: Kit | str | None = None,
    *,
    friction: Bounds = None,
    gap: Bounds = None,
    props: bool = True,
    seconds: float = 60.0,
    progress: Callable[[str], None] = lambda text: None,
    planner: PlannerChoice = BY_EXACT,
) -> Plan:
    """Blocks, order and proof for a design of cells.

    Args:
        kit: a kit as it is, or the name or file of one, whose blocks become as large as the cells
            of the design; by default the one the design names, else ``bricks-lintels``.
        friction: Coulomb coefficient, or the range to prove every step for; that of the kit
            without it.
        gap: width of vertical joints [m], or the range to prove every step for. With 0, side faces
            may carry what bed faces do not; such steps are called ``tight joints``.
        props: whether temporary blocks may be used; the agent uses none.
        seconds: wall-clock limit of planning and proof.
        progress: told what is being done.
        planner: who chooses blocks and order.

    Returns:
        The plan, with the assembly in :attr:`~.plan.Plan.assembly`.

    Raises:
        InputError: for a kit that does not exist or cannot fill the cells, and for limits that make
            no sense.
    """
    started = time.perf_counter()
    if not isinstance(kit, Kit):
        kit = load_kit(kit or design.kit or DEFAULT_KIT).at_pitch(design.cell)
    widest_joint(gap, kit.joint_gap, kit.pitch)
    progress("choosing blocks and proving their order")
    left = max(seconds - (time.perf_counter() - started), 1.0)
    limits = PlanLimits(friction, gap, props, left)
    chosen = PLANNERS[planner.name].choose(design, kit, limits, planner, progress)
    tiling, ordering, search, played = chosen
    empty = tiling.missing or not tiling.placements
    if tiling.status == "refused" and empty and not kit.limited and planner.name == EXACT:
        raise InputError("kit", kit.name, f"one that fills every cell ({tiling.reason})")
    return report_plan(
        design,
        kit,
        tiling,
        ordering,
        seconds=time.perf_counter() - started,
        planner=planner.name,
        agent=played,
        search=search,
    )


def report_plan(
    design: CellDesign,
    kit: Kit,
    tiling: Tiling,
    ordering: Ordering | None,
    *,
    seconds: float,
    planner: str,
    agent: str | None = None,
    search: plans.SearchReport | None = None,
) -> Plan:
    """The plan of blocks and their order, whoever chose them: complete where it fills the cells.

    Args:
        kit: with blocks as large as the cells of the design.
        seconds: that choosing and ordering took.
        planner, agent, search: see :class:`~.plan.Plan`.
    """
    started = time.perf_counter()
    ordered = ordering or Ordering((), tiling.status, tiling.reason)
    standing = {s.block for s in ordered.steps} - {s.remove for s in ordered.steps}
    filled, cells = np.zeros_like(design.wanted), [np.empty((0, 3), np.int64)]
    at = np.concatenate(cells + [placement_cells(tiling.placements[n], kit) for n in standing])
    inside = ((at >= 0) & (at < filled.shape)).all(1)
    filled[tuple(at[inside].T)] = True
    outside = int((~inside).sum() + (filled & ~design.wanted).sum())
    wanted = int(design.wanted.sum())
    missing = int((design.wanted & ~filled).sum())
    strange = None
    if (shades := design.shades) is not None:
        strange = sum(
            int(strange_cells(shades[tuple(placement_cells(p, kit).T)][None])[0])
            for p in (tiling.placements[n] for n in standing)
            if not p.prop
        )
    done = bool(tiling.status == ordered.status == "complete" and not missing and not outside)
    reason = None if done else ordered.reason or tiling.reason or f"{missing} cells are open"
    statuses = tiling.status, ordered.status
    refused = "refused" in statuses
    needed = len(tiling.placements)
    if done and design.blocks is not None and needed > design.blocks:
        done, refused = False, True
        removed = needed - len(standing)
        and_props = f", {removed} of them props," if removed else ""
        reason = (
            f"{needed} blocks of kit `{kit.name}`{and_props} are needed; "
            f'the design has {design.blocks} ("blocks")'
        )
    assembly = None
    if tiling.placements:
        pressed = any(step.proof == TIGHT for step in ordered.steps)
        made = to_assembly(tiling, ordering, kit, name=design.name, gap=0.0 if pressed else None)
        assembly = _coloured(made, design, kit.pitch)
    steps, covered = list[Step](), 0
    for number, step in enumerate(ordered.steps, 1):
        assert assembly is not None
        placement, block = tiling.placements[step.block], assembly.blocks[step.block]
        if step.place is not None and not placement.prop:
            covered += len(placement_cells(placement, kit))
        action = "remove" if step.place is None else "place"
        made = plans.block_step(number, step.block, block, action, covered / max(wanted, 1))
        wait = kit.joint.age if step.wait else None
        steps.append(replace(made.with_proof(step.proof, step.margin_g), wait_h=wait))
    low, high = ordered.friction_range
    least = ordered.margin_friction
    return Plan(
        design=PlanDesign(
            name=design.name,
            source=design.source,
            block_edge=kit.pitch[2],
            shape=_shape(design.wanted),
            cell=_point(np.array(kit.pitch)),
            iou=None if design.iou is None else round(float(design.iou), 6),
            volume_error=rounded(design.volume_error),
            not_read=design.not_read,
            note=design.note or None,
            drawn=design.drawn or None,
        ),
        status=(
            "complete"
            if done
            else "refused"
            if refused
            else "not found"
            if "not found" in statuses
            else "incomplete"
        ),
        reason=reason,
        blocks=plans.BlockSupply(len(tiling.placements), len(standing), ()),
        steps=tuple(steps),
        coverage=round((wanted - missing) / max(wanted, 1), 6),
        seconds=round(seconds + time.perf_counter() - started, 3),
        planning_s=round(max(seconds - ordered.seconds, 0.0), 3),
        proof_s=round(ordered.seconds, 3),
        planner=planner,
        agent=agent,
        search=search,
        kit=kit.name,
        blamed=() if done else _blamed(tiling, ordered, kit),
        cells=plans.CellCount(wanted, missing, outside, strange),
        verified_by="static equilibrium of every step",
        friction_range=(round(low, 6), round(min(high, plans.LARGEST), 6)),
        gap_range=ordered.gap_range,
        margin_friction=None if least is None else rounded(least),
        assembly=assembly,
    )


def _blamed(tiling: Tiling, ordered: Ordering, kit: Kit) -> tuple[plans.BlamedCells, ...]:
    """The cells that are to blame for a design's not being built, by reason."""

    def cells_of(blocks: Iterable[int]) -> list[Cell]:
        return [
            (x, y, z)
            for block in blocks
            for x, y, z in placement_cells(tiling.placements[block], kit).tolist()
        ]

    stuck = ordered.stuck[:1]
    groups: tuple[tuple[plans.Why, Sequence[Cell]], ...] = (
        ("not filled", tiling.missing),
        ("not carried", tiling.lacking),
        ("cannot be placed", cells_of(stuck)),
        ("would fall", cells_of(block for block in ordered.falls if block not in stuck)),
    )
    return tuple(plans.BlamedCells(why, tuple(sorted(cells))) for why, cells in groups if cells)


def _coloured(
    assembly: Assembly, design: CellDesign, pitch: tuple[float, float, float]
) -> Assembly:
    """Blocks in the most frequent colour of their cells, where the design has colours; near
    colours count together."""
    if design.colours is None:
        return assembly
    shades = np.zeros(design.wanted.shape, np.int64) if design.shades is None else design.shades
    size = np.array(pitch)
    middle = np.array([design.wanted.shape[0] / 2, design.wanted.shape[1] / 2, 0.0])
    blocks = list[Block]()
    for block in assembly.blocks:
        low = np.rint(block.vertices.min(0) / size + middle).astype(int)
        high = np.rint(block.vertices.max(0) / size + middle).astype(int)
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        seen = design.colours[box][design.wanted[box]]
        if block.prop or not len(seen):
            blocks.append(block)
            continue
        _, shade, number = np.unique(
            shades[box][design.wanted[box]], return_inverse=True, return_counts=True
        )
        seen = seen[np.isin(shade, np.flatnonzero(number == number.max()))]
        colours, count = np.unique(seen, axis=0, return_counts=True)
        # Of those seen in equally many cells, the one nearest their mean.
        most = colours[count == count.max()].astype(float)
        nearest = most[np.square(most - seen.mean(0)).sum(1).argmin()]
        red, green, blue = (int(c) for c in nearest)
        blocks.append(replace(block, colour=(red, green, blue)))
    return replace(assembly, blocks=tuple(blocks))


def _shape(wanted: np.ndarray) -> tuple[int, int, int]:
    x, y, z = wanted.shape
    return x, y, z


def _point(xyz: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (round(float(c), 6) for c in xyz)
    return x, y, z
