"""What came of planning: a value with typed steps, and the one schema of ``plan.json``.

The fields are the keys of the file (``docs/plan.md``). Lengths are metres in the world frame, z up;
quaternions are (w, x, y, z).
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from learn2assemble.errors import InputError, as_both
from learn2assemble.files import MAX_GENERATED, as_path, make_folder, read_text, write_file
from learn2assemble.planning.folder import (
    FORMAT,
    check_own,
    read_beside,
    write_records,
)
from learn2assemble.planning.reports import ArmReport, BuilderArm, RebuildReport
from learn2assemble.progress import Progress, silent
from learn2assemble.registry import Registry
from learn2assemble.values import Range, from_plain, integer, load_json, mapping, rounded, to_plain

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly, Block
    from learn2assemble.motion.record import BuildRecord

VERSION = 3
KIND = "plan.json or its folder"
Metre = Annotated[float, Range(-1e3, 1e3)]
Seconds = Annotated[float, Range(0, 1e9)]
Share = Annotated[float, Range(-100, 1.001)]
Count = Annotated[int, Range(0, 1e6)]
Bound = Annotated[float, Range(0, 1e6)]
Unit = Annotated[float, Range(-1.001, 1.001)]
Point = tuple[Metre, Metre, Metre]
Quaternion = tuple[Unit, Unit, Unit, Unit]
Status = Literal["complete", "incomplete", "refused", "not found"]
Why = Literal["not filled", "not carried", "cannot be placed", "would fall"]
_Index = Annotated[int, Range(0, 1e6)]
Action = Literal["place", "remove", "hold", "release"]
Relation = Literal["top", "left", "right", "front", "behind"]


@dataclass(frozen=True)
class PlanTarget:
    """One side of the target of a task."""

    name: str
    outline: tuple[Point, ...]
    """Corners in the plane of the outer faces of the blocks of this side, clockwise as seen from
    outside."""

    @property
    def outward(self) -> Point:
        """Unit vector towards who sees this side."""
        corners = zip(self.outline, (*self.outline[1:], self.outline[0]), strict=True)
        x = y = 0.0
        for (ax, ay, az), (bx, by, bz) in corners:
            x, y = x + az * by - ay * bz, y + ax * bz - az * bx
        length = math.hypot(x, y) or 1.0
        return x / length, y / length, 0.0


@dataclass(frozen=True)
class PlanBox:
    """Where a structure without a drawing has to be, or must not be."""

    what: Literal["occupy", "reach", "load", "obstacle"]
    """``reach`` and ``load`` are a face, without height."""
    low: Point
    """Lowest and highest corner."""
    high: Point


@dataclass(frozen=True)
class PlanDesign:
    """What was to be built."""

    name: str
    source: str
    """The file or task it came from."""
    block_edge: Annotated[float, Range(1e-4, 10)]
    """Height of a block of one cell."""
    targets: tuple[PlanTarget, ...] = ()
    """What the blocks of a task shall cover; a design says it in cells."""
    success_threshold: Share = 1.0
    """Delta: the target is filled when the coverage exceeds it."""
    shape: tuple[Count, Count, Count] | None = None
    """Cells of the kit's lattice along x, y and z."""
    cell: tuple[Metre, Metre, Metre] | None = None
    """Edges of a cell. Cell (i, j, k) has its centre at ((i + 0.5 - X/2) dx, (j + 0.5 - Y/2) dy,
    (k + 0.5) dz), with X and Y of :attr:`shape`."""
    iou: Share | None = None
    """Intersection over union of drawing and wanted cells."""
    volume_error: Annotated[float, Range(-1e6, 1e6)] | None = None
    """Volume of the wanted cells less that of the drawing, as a share of the latter."""
    not_read: str | None = None
    """What is visible in the file and is not part of the design, in one line."""
    note: str | None = None
    """What was done to the file to read it."""
    drawn: tuple[str, ...] | None = None
    """Of a drawing or picture, the sides it shows; the viewer of its ``front`` stands at -y."""
    boxes: tuple[PlanBox, ...] = ()
    """Of goals: what has to be filled, reached or loaded, and what stays empty."""


@dataclass(frozen=True)
class SearchStage:
    """One thing the planner tried."""

    stage: str
    result: str
    seconds: Seconds


@dataclass(frozen=True)
class SearchReport:
    """What it took to find the plan."""

    needed: str
    """The stage that found it."""
    budget: Count
    attempts: tuple[SearchStage, ...] = ()


@dataclass(frozen=True)
class BlockSupply:
    """The blocks there are."""

    available: Count
    """How many, the first block of a task included."""
    used: Count
    waiting: tuple[Point, ...] = ()
    """With an arm: where each block of the assembly is taken from."""


LARGEST = 1e3
"""Margins [g] and coefficients of friction are written up to this; it stands for any larger."""


@dataclass(frozen=True)
class Step:
    """One block is placed, held or let go, or a prop taken away."""

    step: Count
    """From 1."""
    block: Count
    """Index of the block in :attr:`Plan.assembly`, from 0; files call it by its ``id``, as
    ``block-1``: ``plan.assembly.blocks[step.block].id``."""
    position: Point
    """Centre of the block after it has settled."""
    quaternion: Quaternion
    action: Action = "place"
    """``hold`` and ``release``: a hand holds a block in its place from this step on, or lets go."""
    kind: str | None = None
    """Kind of the block in the kit."""
    prop: bool = False
    """Whether it is temporary."""
    reference: Count | None = None
    """Of a task: the step whose block it goes next to; 0 is what stands from the start."""
    relation: Relation | None = None
    """Where: on top of that block or at which side."""
    coverage: Share = 0.0
    """Share of the cells that is filled after the step; of a task, F_co of the paper."""
    sides: tuple[Share, ...] = ()
    """Of a task: the share of each target that is covered, the first block included."""
    margin_g: Annotated[float, Range(-1e6, 1e6)] | None = None
    """Smallest horizontal acceleration that static equilibrium does not withstand [g]."""
    tilt_deg: Annotated[float, Range(-180, 180)] | None = None
    """Smallest tilt of the table that it does not withstand [deg]."""
    margin_n: Annotated[float, Range(-1e6, 1e6)] | None = None
    """Of bricks that clutch: what a contact point can pull more than it needs to [N]."""
    proof: str | None = None
    """What proves that everything stands after the step."""
    outcome: str | None = None
    """With an arm: what came of the attempt that placed it."""
    grasp: str | None = None
    """With an arm: how the block was held."""
    by_hand: bool = False
    """With an arm: the step is done by hand, and the build waits for it."""
    way: Literal["above", "below", "beside"] | None = None
    """Of a brick that clutches: whence it comes; ``beside``: it is built on another one beside, and
    attached with it when that is released."""
    wait_h: Annotated[float, Range(0, 1e6)] | None = None
    """Hours that one waits before the step, until the mortar of all that stands holds."""
    arm: str | None = None
    """Which of several arms does it."""

    def with_proof(self, proof: str, margin_g: float | None) -> Step:
        """The step with this proof and this margin [g]; None: none is known."""
        tilt = None if margin_g is None else round(math.degrees(math.atan(margin_g)), 3)
        worth = None if margin_g is None else round(min(float(margin_g), LARGEST), 6)
        return dataclasses.replace(self, proof=proof, margin_g=worth, tilt_deg=tilt)


def block_step(number: int, index: int, block: Block, action: Action, coverage: float) -> Step:
    """The step with a number, from 1, of a block with an index in its assembly."""
    x, y, z = (rounded(c) for c in block.centroid.tolist())
    return Step(
        step=number,
        block=index,
        position=(x, y, z),
        quaternion=(1.0, 0.0, 0.0, 0.0),
        action=action,
        kind=block.kind or None,
        prop=block.prop,
        coverage=round(coverage, 6),
    )


@dataclass(frozen=True)
class CellCount:
    """The drawing as cells of the kit's lattice."""

    wanted: Count
    missing: Count
    """Wanted and not filled."""
    outside: Count
    """Filled and not wanted."""
    other_colour: Count | None = None
    """Filled by a block of another colour; None where the design has one colour or none."""


@dataclass(frozen=True)
class BlamedCells:
    """Cells of a drawing that are to blame for its not being built, all for the same reason."""

    why: Why
    """``not filled``: no blocks of the kit fill them; ``not carried``: nothing carries what fills
    them; ``cannot be placed``: those of a block that does not stand when it is placed, or of a prop
    that cannot be taken away; ``would fall``: those of blocks that would move if it were placed."""
    cells: tuple[tuple[_Index, _Index, _Index], ...]
    """Indices on the lattice of the design, see :attr:`PlanDesign.cell`."""


@dataclass(frozen=True)
class Plan:
    """How a design is built, step by step, and the proof that every step holds.

    Raises:
        InputError: for steps that contradict one another.
    """

    design: PlanDesign
    status: Status
    """``refused``: proven to be impossible, or, where :attr:`not_placed` blocks were found, the arm
    cannot make the order; ``not found``: neither found nor ruled out."""
    reason: str | None
    """What is missing, in one sentence."""
    blocks: BlockSupply
    steps: tuple[Step, ...]
    coverage: Share
    """F_co at the end."""
    seconds: Seconds
    """Wall time of planning and proof."""
    agent: str | None = None
    planner: str | None = None
    kit: str | None = None
    search: SearchReport | None = None
    cells: CellCount | None = None
    blamed: tuple[BlamedCells, ...] = ()
    """Of a drawing that is not built: which cells are to blame, where that is known."""
    verified_by: str | None = None
    planning_s: Seconds | None = None
    """Of :attr:`seconds`, what choosing the blocks took."""
    proof_s: Seconds | None = None
    """Of :attr:`seconds`, what order and proof took."""
    friction_range: tuple[Bound, Bound] | None = None
    """Coefficients of friction for which every step is proven to stand."""
    gap_range: tuple[Metre, Metre] | None = None
    """Widths of vertical joints for which every step is proven to stand."""
    margin_friction: Bound | None = None
    """The coefficient of friction that margins are for: the least that was asked for."""
    rebuilt: RebuildReport | None = None
    """Where the steps begin at a structure that stands already."""
    arm: ArmReport | None = None
    arms: tuple[BuilderArm, ...] = ()
    """Where several arms build: who they are, and what they did."""
    robot_s: Seconds | None = None
    """Where several arms have built: their time until the last block was placed."""
    records: tuple[BuildRecord, ...] = field(
        default=(), compare=False, repr=False, metadata={"file": False}
    )
    """The motion of each arm that has built, on one clock; :func:`~.folder.trajectory_names`."""
    assembly: Assembly | None = field(
        default=None, compare=False, repr=False, metadata={"file": False}
    )
    """The blocks as polyhedra, with the steps; ``assembly.json`` holds them. What no step places
    stands from the start, or is not built."""

    def __post_init__(self) -> None:
        for number, step in enumerate(self.steps, 1):
            where = f"steps[{number - 1}]"
            if step.step != number:
                raise InputError(f"{where}.step", step.step, str(number))
            if step.reference is not None and step.reference >= number:
                raise InputError(f"{where}.reference", step.reference, f"0 to {number - 1}")
            if step.sides and len(step.sides) != len(self.design.targets):
                expected = f"{len(self.design.targets)} shares, one for each target"
                raise InputError(f"{where}.sides", len(step.sides), expected)
            if self.assembly is not None and step.block >= len(self.assembly.blocks):
                last = len(self.assembly.blocks) - 1
                raise InputError(f"{where}.block", step.block, f"0 to {last}, of the assembly")
            if abs(sum(q * q for q in step.quaternion) - 1) > 1e-2:
                expected = "(w, x, y, z) of length 1"
                raise InputError(f"{where}.quaternion", step.quaternion, expected)

    @property
    def record(self) -> BuildRecord | None:
        """With one arm: its motion, which ``trajectory.json`` holds."""
        return self.records[0] if len(self.records) == 1 else None

    @property
    def by_turns(self) -> bool:
        """Whether two arms build it one after the other: one holds a block while the other one
        brings the next, or somebody works between them by hand."""
        return any(step.action == "hold" or step.by_hand for step in self.steps)

    @property
    def complete(self) -> bool:
        """Whether the target is filled and every step holds."""
        return self.status == "complete"

    @property
    def found_nothing(self) -> bool:
        """Whether it was refused, or nothing was found: not one block is in it."""
        none = not self.steps and self.blocks.available == 0
        return none and not self.complete and self.assembly is None

    @property
    def not_placed(self) -> int:
        """Blocks that were found and stand, but of which the arm has placed none: it cannot place
        all of them, or was stopped before."""
        if self.steps or self.complete or not (self.arm or self.arms):
            return 0
        blocks = self.assembly.blocks if self.assembly else ()
        return sum(not (block.prop or block.support) for block in blocks)

    @property
    def as_planned(self) -> bool:
        """Whether :attr:`cells` are those of all blocks that were found, of which the arm has not
        placed all."""
        return not self.complete and bool(self.arm or self.arms)

    @property
    def proven_for(self) -> dict[str, str]:
        """In words, what every step of a complete plan is proven for: ``friction``, ``joints``."""
        words: dict[str, str] = {}

        def said(low: float, high: float) -> str:
            return f"{low:g}" if low == high else f"{low:g} to {high:g}"

        if self.complete and self.friction_range:
            low, high = self.friction_range
            words["friction"] = said(low, high) if high < LARGEST else f"{low:g} or more"
        if self.complete and self.gap_range:
            low, high = (1e3 * gap for gap in self.gap_range)
            if low < high:  # No more is said than is proven.
                low, high = math.ceil(100 * low - 1e-6) / 100, math.floor(100 * high + 1e-6) / 100
            words["joints"] = f"{said(low, high)} mm"
        return words

    @property
    def margin_g(self) -> float | None:
        """Smallest margin of all steps [g]."""
        return min((s.margin_g for s in self.steps if s.margin_g is not None), default=None)

    @property
    def without_margin(self) -> int:
        """Steps whose margin is not known."""
        return sum(step.margin_g is None for step in self.steps)

    def to_dict(self) -> dict[str, Any]:
        """The content of ``plan.json``."""
        return {"format": FORMAT, "version": VERSION, **to_plain(self)}

    @classmethod
    def from_dict(cls, data: Any, source: str = "plan") -> Plan:
        """The plan that a parsed ``plan.json`` holds.

        Raises:
            InputError: naming ``source`` and the path of what is wrong.
        """
        root = dict(mapping(data, source))
        form, version = root.pop("format", None), root.pop("version", None)
        if form != FORMAT:
            raise InputError(f"{source}: format", form, repr(FORMAT))
        if integer(version, f"{source}: version") != VERSION:
            raise InputError(f"{source}: version", version, str(VERSION))
        try:
            return from_plain(cls, root, source)
        except InputError as error:
            if error.what.startswith(source):
                raise
            raise InputError(f"{source}: {error.what}", error.got, error.expected) from None

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """The plan in a ``plan.json`` or its folder, with the trajectory beside it if any.

        Raises:
            InputError: one line that names the file and the JSON path of the fault.
        """
        file = as_path(path, "plan")
        file = file / "plan.json" if file.is_dir() else file
        text, source = read_text(file, KIND, MAX_GENERATED)
        if text.strip() and text.lstrip()[0] != "{":
            raise InputError(source, "a file of another kind", KIND)
        plan = cls.from_dict(load_json(text, source, KIND), source)
        records, blocks = read_beside(file, max(len(plan.arms), 1))
        return dataclasses.replace(plan, records=records, assembly=blocks)

    def save(
        self,
        folder: str | Path,
        video: bool = False,
        page: bool = True,
        progress: Progress = silent,
    ) -> dict[str, Path]:
        """Write ``plan.json``, with an arm its trajectory, and what else is asked for.

        Args:
            folder: made where it does not exist; the files of a plan that was saved in it are
                replaced.
            video: also ``build.mp4``, of a plan with an arm; needs the extra ``video``.
            page: also ``view.html`` and ``progress.png``.
            progress: told what takes long.

        Returns:
            Which file is what.

        Raises:
            InputError: where something cannot be written, or a file of such a name is not that of a
                plan (:func:`check_own`). A motion that is not sound is no reason
                to lose a finished build: all files are written, and ``arm.motion_fault`` says so.
        """
        check_own(folder := as_path(folder, "folder"))
        said = self._with_fault(progress)
        said = dataclasses.replace(said, reason=said.reason and as_both(said.reason))
        make_folder(folder, "folder")
        files = {"plan": folder / "plan.json"}
        text = json.dumps(said.to_dict(), indent=1, allow_nan=False) + "\n"
        write_file(files["plan"], text, "plan")
        if self.assembly is not None:
            files |= EXPORTS["assembly"](self, folder, progress)
        if page:
            files |= self.write_page(folder)
        files |= write_records(folder, self.records)
        from learn2assemble.motion.attempts import anything_to_play

        if video and anything_to_play(self.records):
            files |= EXPORTS["video"](self, folder, progress)
        return files

    def _with_fault(self, progress: Progress) -> Plan:
        """The same, with what is wrong with the motion of an arm, if anything is."""
        did = [self.arm] if self.arm is not None else [one.did for one in self.arms]
        if len(did) != len(self.records) or None in did:
            return self
        from learn2assemble.motion.record import find_fault

        faults = [find_fault(record) for record in self.records]
        for fault in filter(None, faults):
            progress(f"the recorded motion is not sound: {fault}")
        told = [
            None if one is None or fault is None else dataclasses.replace(one, motion_fault=fault)
            for one, fault in zip(did, faults, strict=True)
        ]
        if self.arm is not None:
            return dataclasses.replace(self, arm=told[0] or self.arm)
        arms = zip(self.arms, told, strict=True)
        named = tuple(dataclasses.replace(a, did=new) if new else a for a, new in arms)
        return dataclasses.replace(self, arms=named)

    def write_page(self, folder: Path) -> dict[str, Path]:
        """Write ``view.html`` and ``progress.png``, see :meth:`save`; which file is what."""
        check_own(folder)
        return EXPORTS["page"](self, folder, silent)


Exporter = Callable[[Plan, Path, Progress], dict[str, Path]]
"""Writes something of a plan into a folder, and tells how far it is; returns which file is what."""
EXPORTS: Registry[Exporter] = Registry("export", {})
"""What can be written of a plan, besides itself."""


def load_plan(path: str | Path) -> Plan:
    """The plan in a ``plan.json`` or its folder, see :meth:`Plan.load`."""
    return Plan.load(path)
