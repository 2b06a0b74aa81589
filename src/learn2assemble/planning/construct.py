"""Exact planning: a design of cells becomes blocks of a kit, an order, and a proof of every step.

Nothing here is learned: :mod:`.tiling` chooses the blocks, :mod:`.ordering` the order, and what is
called complete fills every wanted cell and no other. An assembly whose blocks are given only needs
an order and the proof.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block, Step
from learn2assemble.assembly.contacts import Contacts, check_overlaps, shrunk
from learn2assemble.assembly.kit import DEFAULT_KIT, Cell, Kit, load_kit
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError
from learn2assemble.planning import plan as plans
from learn2assemble.planning.advice import NO_ADVICE, advise
from learn2assemble.planning.exact import plan_exact
from learn2assemble.planning.ordering import (
    BED,
    POINTS,
    TIGHT,
    Bounds,
    Ordering,
    to_assembly,
    value_range,
)
from learn2assemble.planning.plan import Plan, PlanDesign
from learn2assemble.planning.tiling import Tiling, placement_cells, strange_cells

if TYPE_CHECKING:
    from learn2assemble.planning.agent.arm import Hand

EXACT, AGENT = "exact", "agent"
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def plan_cells(
    design: CellDesign,
    kit: Kit | str | None = None,
    *,
    friction: Bounds = None,
    gap: Bounds = None,
    props: bool = True,
    seconds: float = 60.0,
    progress: Callable[[str], None] = lambda text: None,
    planner: str = EXACT,
    builder: str | None = None,
    seed: int = 0,
    hand: Hand | None = None,
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
        planner: ``"exact"``, or ``"agent"``: the learned builder with its search alone.
        builder: the agent, by name or file.
        seed: of the agent's search.
        hand: an arm that makes the agent's placements.

    Returns:
        The plan, with the assembly in :attr:`~.plan.Plan.assembly`.

    Raises:
        InputError: for a kit that does not exist or cannot fill the cells, and for limits that make
            no sense.
    """
    started = time.perf_counter()
    if not isinstance(kit, Kit):
        kit = load_kit(kit or design.kit or DEFAULT_KIT).at_pitch(design.cell)
    progress("choosing blocks and proving their order")
    search = agent = None
    if planner == AGENT:
        from learn2assemble.planning.agent.planner import plan_with_agent

        tiling, ordering, search, agent = plan_with_agent(
            design.wanted, kit, builder=builder, seed=seed, seconds=seconds,
            friction=friction, gap=gap, hand=hand, props=props,
        )  # fmt: skip
    else:
        left = max(seconds - (time.perf_counter() - started), 1.0)
        tiling, ordering = plan_exact(
            design.wanted, kit, seconds=left, friction=friction, gap=gap, props_allowed=props,
            shades=design.shades,
        )  # fmt: skip
        if (ordering or tiling).status in ("refused", "not found") and tiling.placements:
            left = seconds - (time.perf_counter() - started)
            help_ = advise(tiling, kit, left, progress, friction=friction, gap=gap,
                           props_allowed=props)  # fmt: skip
            why = f"{(ordering or tiling).reason}; {help_ or NO_ADVICE}"
            tiling = replace(tiling, reason=why)
            ordering = None if ordering is None else replace(ordering, reason=why)
    empty = tiling.missing or not tiling.placements
    if tiling.status == "refused" and empty and not kit.limited and planner == EXACT:
        raise InputError("kit", kit.name, f"one that fills every cell ({tiling.reason})")
    return report_plan(
        design, kit, tiling, ordering, seconds=time.perf_counter() - started, planner=planner,
        agent=agent, search=search,
    )  # fmt: skip


def report_plan(
    design: CellDesign, kit: Kit, tiling: Tiling, ordering: Ordering | None, *, seconds: float,
    planner: str, agent: str | None = None, search: plans.SearchReport | None = None,
) -> Plan:  # fmt: skip
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
        strange = sum(int(strange_cells(shades[tuple(placement_cells(p, kit).T)][None])[0])
                      for p in (tiling.placements[n] for n in standing) if not p.prop)  # fmt: skip
    done = bool(tiling.status == ordered.status == "complete" and not missing and not outside)
    reason = None if done else ordered.reason or tiling.reason or f"{missing} cells are open"
    statuses = tiling.status, ordered.status
    refused = "refused" in statuses
    needed = len(tiling.placements)
    if done and design.blocks is not None and needed > design.blocks:
        done, refused = False, True
        removed = needed - len(standing)
        and_props = f", {removed} of them props," if removed else ""
        reason = (f"{needed} blocks of kit `{kit.name}`{and_props} are needed; "
                  f"the design has {design.blocks} (\"blocks\")")  # fmt: skip
    assembly = None
    if tiling.placements:
        pressed = any(step.proof == TIGHT for step in ordered.steps)
        made = to_assembly(tiling, ordering, kit, name=design.name, gap=0.0 if pressed else None)
        assembly = _coloured(made, design, kit.pitch)
    steps, covered = [], 0
    for number, step in enumerate(ordered.steps, 1):
        assert assembly is not None
        placement, block = tiling.placements[step.block], assembly.blocks[step.block]
        if step.place is not None and not placement.prop:
            covered += len(placement_cells(placement, kit))
        steps.append(_step(number, step.block, block, step.place is None, step.margin_g,
                           step.proof, covered / max(wanted, 1)))  # fmt: skip
    low, high = ordered.friction_range
    return Plan(
        design=PlanDesign(
            name=design.name,
            source=design.source,
            block_edge=kit.pitch[2],
            shape=_shape(design.wanted),
            cell=_point(np.array(kit.pitch)),
            iou=None if design.iou is None else round(float(design.iou), 6),
            volume_error=round(float(design.volume_error), 6),
            not_read=design.not_read,
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
        assembly=assembly,
    )


def _blamed(tiling: Tiling, ordered: Ordering, kit: Kit) -> tuple[plans.BlamedCells, ...]:
    """The cells that are to blame for a design's not being built, by reason."""

    def cells_of(blocks: Iterable[int]) -> list[Cell]:
        return [(x, y, z) for block in blocks
                for x, y, z in placement_cells(tiling.placements[block], kit).tolist()]  # fmt: skip

    stuck = ordered.stuck[:1]
    groups: tuple[tuple[plans.Why, Sequence[Cell]], ...] = (
        ("not filled", tiling.missing),
        ("not carried", tiling.lacking),
        ("cannot be placed", cells_of(stuck)),
        ("would fall", cells_of(block for block in ordered.falls if block not in stuck)),
    )
    return tuple(plans.BlamedCells(why, tuple(sorted(cells))) for why, cells in groups if cells)


def plan_assembly(
    assembly: Assembly,
    *,
    friction: Bounds = None,
    gap: Bounds = None,
    seconds: float = 60.0,
    progress: Callable[[str], None] = lambda text: None,
    source: str = "",
) -> Plan:
    """Order and proof for blocks that are given where they stand.

    The order of the file is kept where it has one; else blocks go from below, each after the
    blocks it lies on, and one that would fall waits. Every state is proven as
    :func:`learn2assemble.physics.rigid_blocks.check` does, on what weight presses together where
    that holds, else with side faces that press, and the step says which; edges and points carry,
    too.

    Args:
        friction: Coulomb coefficient, or the range to prove every step for (at both its ends),
            instead of the assembly's.
        gap: width to which vertical joints may open, or a range of widths [m]. Above 0 side faces
            carry nothing, nor do edges and points, and every bed face is taken to be smaller by
            half of it on all sides.
            Without it, side faces press where the file has them touch.
        seconds: wall-clock limit; the steps proven until then are kept.

    Raises:
        InputError: for blocks that overlap, where nothing stands on a support or the ground, and
            for joints wider than the blocks.
    """
    started = time.perf_counter()
    check_overlaps(assembly)
    ends = value_range(friction, assembly.friction, "friction")
    widest = value_range(gap, 0.0, "gap")[1]
    states = _States(assembly, ends, widest)
    count, support = len(assembly.blocks), states.joints.support
    below = states.below()
    given = [(s.place, s.remove) for s in assembly.steps]
    queue = [assembly.index(p or r or "") for p, r in given]
    if not given:
        heights = [float(block.vertices[:, 2].min()) for block in assembly.blocks]
        queue = [k for k in sorted(range(count), key=lambda k: (heights[k], k)) if not support[k]]
    present = support.copy()
    steps: list[plans.Step] = []
    made: list[Step] = []
    reason = None
    while queue and reason is None:
        if time.perf_counter() - started > seconds:
            reason = f"time ran out after {seconds:g} s with {len(steps)} steps proven; "
            reason += "--seconds gives more"
            break
        # Stones that lie on one another in a ring have no first one.
        ready = [k for k in queue if all(present[n] for n in below[k])] or queue
        ready = queue[:1] if given else ready
        certain = True
        for index in ready:
            removing = bool(present[index])
            present[index] = not removing
            proof, pressing = states.decide(present)
            if pressing is not None:
                break
            certain &= proof == _FALLS
            present[index] = removing
        else:
            names = ", ".join(assembly.blocks[k].id for k in ready[:3])
            what = _FALLS if certain else _UNCERTAIN
            reason = f"no order found: step {len(steps) + 1} {what} with any of {names}"
            if not given and states.decide(np.ones(count, bool))[1] is not None:
                reason += "; all blocks together stand, so something has to hold them until then"
            break
        assert pressing is not None
        queue.remove(index)
        block, number = assembly.blocks[index], len(steps) + 1
        progress(f"step {number}: {block.id}")
        worth = states.margin(pressing, present)
        made.append(Step(remove=block.id) if removing else Step(place=block.id))
        covered = float((present & ~support).sum()) / max((~support).sum(), 1)
        steps.append(_step(number, index, block, removing, worth, proof, covered))
    wanted = sum(not (b.prop or b.support) for b in assembly.blocks)
    used_blocks = sum(bool(present[k]) and not b.support for k, b in enumerate(assembly.blocks))
    done = reason is None
    return Plan(
        design=PlanDesign(name=assembly.name or "assembly", source=source, block_edge=1.0),
        status="complete" if done else "incomplete",
        reason=reason,
        blocks=plans.BlockSupply(wanted, used_blocks, ()),
        steps=tuple(steps),
        coverage=steps[-1].coverage if steps else 0.0,
        seconds=round(time.perf_counter() - started, 3),
        planner=EXACT,
        verified_by="rigid-block equilibrium of every step",
        friction_range=ends,
        gap_range=None if gap is None else (0.0, widest),
        assembly=replace(assembly, steps=tuple(made), not_built=()).as_far_as_placed(),
    )


_FALLS, _UNCERTAIN = "falls", "is not certain to stand"


class _States:
    """What stands of given blocks, by the contacts that ``l2a check`` looks at.

    Args:
        friction: the coefficients at which a state has to stand.
        gap: width to which vertical joints may open [m].
    """

    def __init__(self, assembly: Assembly, friction: tuple[float, float], gap: float) -> None:
        from learn2assemble.physics.rigid_blocks import Joints, bed_patches

        self.assembly, self.friction = assembly, sorted(set(friction))
        self.joints = Joints(assembly)
        self.open: Contacts | None = None
        if gap > 0:
            least = min(float(np.ptp(b.vertices, axis=0)[:2].min()) for b in assembly.blocks)
            if gap >= least:
                raise InputError("gap", gap, f"less than the narrowest block, {least:g} m")
            faces = self.joints.faces
            self.open = shrunk(faces.only(bed_patches(faces)), gap / 2)

    def below(self) -> list[set[int]]:
        """The blocks that each block lies on, without supports."""
        from learn2assemble.physics.rigid_blocks import bed_patches

        contacts = self.joints.faces if self.open is not None else self.joints.every[0]
        lying = contacts.only(bed_patches(contacts))
        found: list[set[int]] = [set() for _ in self.assembly.blocks]
        for a, b, normal in zip(lying.a.tolist(), lying.b.tolist(), lying.normal, strict=True):
            lower, upper = (a, b) if normal[2] > 0 else (b, a)
            if upper >= 0 and lower >= 0 and not self.joints.support[lower]:
                found[upper].add(lower)
        return found

    def decide(self, present: np.ndarray) -> tuple[str, Contacts | None]:
        """The proof that the blocks ``present`` (bool[B]) stand, and the contacts that carry them
        with the least friction; ``_FALLS`` or ``_UNCERTAIN`` and None where there is none."""
        from learn2assemble.physics import rigid_blocks

        if self.open is not None:
            stands = all(rigid_blocks.solve(self.assembly, self.open, mu, present=present).stands
                         for mu in self.friction)  # fmt: skip
            return (BED, self.open) if stands else (_FALLS, None)
        proof, pressing = BED, None
        for mu in self.friction:
            found = self.joints.decide(mu, present)
            if not found.result.stands:
                return _FALLS if found.verdict == rigid_blocks.FALLS else _UNCERTAIN, None
            if found.verdict == rigid_blocks.TIGHT:
                proof = TIGHT
            elif found.contacts is not self.joints.faces:
                proof = POINTS
            if pressing is None:
                pressing = found.contacts.only(found.keep)
        return proof, pressing

    def margin(self, pressing: Contacts, present: np.ndarray) -> float:
        """Sideways acceleration that the blocks ``present`` withstand on these contacts [g]."""
        from learn2assemble.physics.rigid_blocks import margin

        return margin(self.assembly, pressing, self.friction[0], present=present)


def _step(
    number: int, index: int, block: Block, removing: bool, margin_g: float, proof: str,
    coverage: float,
) -> plans.Step:  # fmt: skip
    """A step of a plan, of the block with an index in its assembly."""
    return plans.Step(
        step=number, block=index, position=_point(block.centroid), quaternion=_UPRIGHT,
        action="remove" if removing else "place", kind=block.kind or None, prop=block.prop,
        coverage=round(coverage, 6),
    ).with_proof(proof, margin_g)  # fmt: skip


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
    blocks = []
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
