"""What arms reach with exact plans, measured in the dynamic workcell: ``results/builds.json``.

Every entry is one build, whose arm knows what its readings say and nothing else. Seconds are of the
processor, so that other programs on the machine do not count. Errors are measured in the
simulation, by its true poses, when a build is over.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from l2a_lab import shapes
from l2a_lab.measured import Figures, Result
from l2a_lab.sensing import RIGS, calibration
from l2a_lab.structures import script
from learn2assemble.acting.carry_out import (
    Workcell,
    carry_out,
    carry_out_cells,
    prepare,
    setup_of,
)
from learn2assemble.acting.report import deepest_overlap
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.kit import DEFAULT_KIT, Kit, load_kit
from learn2assemble.cell.site import Site
from learn2assemble.cell.workcell import Job
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.geometry.rotations import quaternion_matrix
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.plants.setup import Disturbance, Noise
from learn2assemble.robot.arm import Arm, get_arm
from learn2assemble.robot.bodies import Solid, solids
from learn2assemble.robot.moves import Scene
from learn2assemble.simulation.plant import DynamicPlant
from learn2assemble.values import to_plain

EXAMPLES = Path("examples/designs")
SMALL_FIRST = (
    "pyramid.json",
    "gate.svg",
    "arch_pair.json",
    "stepped_tower.json",
    "pavilion.json",
    "skyline.json",
    "gabled_house.json",
    "keep.json",
)
"""Examples that are built, those of fewer blocks first."""
DESIGNS = tuple(sorted(SMALL_FIRST))
GIVEN: dict[str, tuple[str, ...]] = {
    "turned wall, 64 bricks": ("suction", "gripper"),
    "arch, 9 voussoirs": ("suction",),
    "pile, 12 cut stones": ("suction",),
}
"""Blocks that are given where they stand, and the tools that can hold them."""
HALF_SIZE = 0.5
"""Bricks of the turned wall are so large against those of its script, so that arms reach it."""
STONES_SEED, STONES_SPREAD = 2, 0.08
FALLS = "leaning_parallelogram.json"
"""The example that falls as drawn, whatever the kit."""
ARMS, TOOLS, SEEDS = ("panda", "ur5e"), ("suction", "gripper"), 10
PLAN_SECONDS = 120.0
LARGE: dict[str, tuple[Callable[[], np.ndarray], float]] = {
    "wall with a window, 100 blocks": (lambda: shapes.wall(20, 3, 16, (7, 13, 5, 10)), 0.032),
    "wall with a window, 158 blocks": (lambda: shapes.wall(20, 6, 18, (7, 13, 5, 11)), 0.032),
}
"""Cells, and the edge of a cell [m]."""
PROPS: dict[str, tuple[Callable[[], np.ndarray], str]] = {
    # Of the bricks none spans the opening of the bridge, so its deck needs props.
    "bridge of span 6": (lambda: shapes.bridge(1, 6, 4, 3, 1, 4), "bricks"),
    "bridge of three spans": (shapes.SHAPES["bridge-long"], DEFAULT_KIT),
}
"""Cells of 4 cm, and the kit they are built of."""
SUPPLY = 1e-3, math.radians(1)
"""How presented blocks stand beside their places: standard deviations [m], [rad]."""
READINGS = Noise(5e-4, math.radians(0.2), 5e-4, missing=0.02)
COARSE = Noise(1e-3, math.radians(0.5), 1e-3, missing=0.02)
"""What is read of blocks by a camera, and by a cheap one."""
WORSE = 12.0
"""So many times the noise has to make builds bad."""
TABLE, HEIGHT = (2e-3, math.radians(0.5)), 3e-4
"""By which the table and the heights of blocks are off in guarded builds [m], [rad]."""
TRACKING = {"panda": 1.1e-4, "ur5e": 3.2e-5}
"""Standard deviations of the zero of a joint [rad] with which the tool, 0.94 m times that away, is
off as data sheets say that poses are repeated (ISO 9283): 0.1 mm and 0.03 mm. How exact an arm is
they do not say; measured were 10 mm, and 0.2 mm after a calibration (Panda, arXiv 2503.12584)."""
FOLLOWED = 10.0
"""So many times that joints are off at full speed."""
TIMES = (1, 3, 10, 30)
"""Of these sizes in builds whose joints are not where they are told to be."""
LATE = Noise(5e-4, math.radians(0.2), 5e-4, missing=0.02, outliers=0.01, late=0.2)
"""Readings of which one of five is of the picture before, and one of a hundred far off."""
WALL, SEEN_SEEDS = "wall of 40 bricks", 16
"""What is built through cameras, cells of 2.5 cm, and how often by each arm."""
FAULTS = 3
"""Blocks that are dropped or pushed in one build."""


def names() -> list[str]:
    """Every measurement: kind / design / arm / tool or seed."""
    found = [f"large/{name}/{arm}" for name in LARGE for arm in ARMS]
    found += [f"props/{name}/{arm}" for name in PROPS for arm in ARMS]
    examples = (*DESIGNS, FALLS)
    found += [f"example/{d}/{arm}/{tool}" for d in examples for arm in ARMS for tool in TOOLS]
    found += [
        f"given/{d}/{arm}/{tool}" for d, tools in GIVEN.items() for arm in ARMS for tool in tools
    ]
    found += [f"program/{d}/{arm}" for d in DESIGNS[:4] for arm in ARMS]
    for kind, seeds in {"noise": range(1), "faults": range(2), "guarded": range(2)}.items():
        found += [f"{kind}/{d}/{arm}/{seed}" for seed in seeds for d in SMALL_FIRST for arm in ARMS]
    coarse = ("touch", "blind")
    found += [f"coarse/{d}/{arm}/{how}" for d in SMALL_FIRST for arm in ARMS for how in coarse]
    found += [
        f"{kind}/{d}/{arm}/0" for kind in ("worse", "late") for d in SMALL_FIRST[:4] for arm in ARMS
    ]
    found += [f"tracking/{d}/{arm}/{n}" for n in TIMES for d in SMALL_FIRST[:4] for arm in ARMS]
    found += [f"seen/{WALL}/{arm}/{seed}" for seed in range(SEEN_SEEDS) for arm in ARMS]
    seeds = range(1, SEEDS)
    found += [f"noise/{d}/{arm}/{seed}" for seed in seeds for d in SMALL_FIRST for arm in ARMS]
    return found


def configuration() -> Result:
    """The disturbances of builds in which nothing is exact."""
    return {
        "supply_mm": 1e3 * SUPPLY[0],
        "supply_deg": math.degrees(SUPPLY[1]),
        "friction_share": 0.2,
        "mass_share": 0.1,
        "readings": [1e3 * READINGS.place, math.degrees(READINGS.turn), READINGS.missing],
        "coarse": [1e3 * COARSE.place, math.degrees(COARSE.turn), COARSE.missing],
        "worse_times": WORSE,
        "late": [LATE.outliers, LATE.late],
        "joint_zero_mrad": {arm: 1e3 * off for arm, off in TRACKING.items()},
        "followed_times": FOLLOWED,
        "table_mm_deg": [1e3 * TABLE[0], math.degrees(TABLE[1])],
        "block_height_mm": 1e3 * HEIGHT,
    }


def entry(name: str) -> Result:
    """One measurement by its name."""
    kind, what, arm, *rest = name.split("/")
    if kind == "given":
        return _given(what, arm, rest[0])
    if kind == "seen":
        return _seen(what, arm, int(rest[0]))
    if kind in INEXACT:
        return _inexact(kind, what, arm, rest[0])
    design, kit = _design(kind, what)
    tool = {"example": rest[0] if rest else "", "props": "suction-side"}.get(kind, "suction")
    workcell = Workcell(arm, tool)
    started = time.process_time()
    plan = plan_cells(design, kit, seconds=PLAN_SECONDS)
    planned = time.process_time()
    done = carry_out_cells(
        plan,
        kit,
        workcell,
        lambda text: None,
        lambda other: plan_cells(design, other, seconds=PLAN_SECONDS),
    )
    result = _described(done, planned - started, time.process_time() - planned)
    if done.complete and kind == "props":
        result |= {"settled": _settled(done)}
    return result | (_program(done) if kind in ("program", "props") and done.complete else {})


def _seen(what: str, arm: str, seed: int) -> Result:
    """A build that is seen through two cameras, 3 mm and 1 degree off until they are calibrated."""
    cameras = RIGS["two cameras"]
    found = calibration(seed, cameras)
    rng = np.random.default_rng([seed, *what.encode(), *arm.encode()])
    friction = float(rng.uniform(-0.2, 0.2))
    told = Disturbance(supply=SUPPLY, friction=friction, mass=0.1, cameras=found.off)
    kit = load_kit("bricks").at_pitch((0.025, 0.025, 0.025))
    started = time.process_time()
    design = CellDesign(what, shapes.wall(16, 2, 9), kit.pitch)
    plan, planned = plan_cells(design, kit, seconds=PLAN_SECONDS), time.process_time()
    at = Workcell(arm, "suction", Site(cameras=found.cameras), seed=seed, disturbance=told)
    done = carry_out(plan, at, joint=kit.joint_gap)
    result = _described(done, planned - started, time.process_time() - planned)
    return result | {"cameras_off_mm": [found.before_mm, found.after_mm]}


INEXACT = ("noise", "faults", "guarded", "coarse", "worse", "late", "tracking")
"""Kinds of builds in which nothing is exact."""


def _inexact(kind: str, what: str, arm: str, last: str) -> Result:
    """A build by what is sensed: noise, blocks that are dropped and pushed, a table that is off."""
    # Joints that are off by more are off in builds that are the same otherwise.
    seed = int(last) if last.isdigit() and kind != "tracking" else 0
    rng = np.random.default_rng([seed, *what.encode(), *arm.encode()])
    design, kit = _design(kind, what)
    started = time.process_time()
    plan = plan_cells(design, kit, seconds=PLAN_SECONDS)
    friction = float(rng.uniform(-0.2, 0.2))
    told = Disturbance(supply=SUPPLY, friction=friction, mass=0.1)
    noise = READINGS
    if kind == "faults":
        count = len(plan.steps)
        at = rng.choice(np.arange(2, max(count, FAULTS + 2)), FAULTS, replace=False).tolist()
        dropped = frozenset(at[: 1 + seed % 2])
        told = told._replace(drop=dropped, push=frozenset(at) - dropped)
    elif kind == "guarded":
        told = told._replace(table=TABLE, height=HEIGHT)
    elif kind == "coarse":
        told, noise = told._replace(supply=(2 * SUPPLY[0], 2 * SUPPLY[1])), COARSE
    elif kind == "worse":
        far = WORSE * READINGS.place
        noise = Noise(far, WORSE * READINGS.turn, missing=READINGS.missing)
        told = told._replace(supply=(WORSE * SUPPLY[0], WORSE * SUPPLY[1]))
    elif kind == "late":
        noise = LATE
    elif kind == "tracking":
        zero = int(last) * TRACKING[arm]
        told = told._replace(tracking=(zero, FOLLOWED * zero))
    # No two builds have the same table, readings and blocks.
    seed = int(rng.integers(2**31))
    at = Workcell(arm, "suction", seed=seed, noise=noise, disturbance=told, touch=last != "blind")
    planned = time.process_time()
    found = prepare(plan, at, kit.joint_gap)
    plant = DynamicPlant(setup_of(found.job, at, found.structure))
    done = carry_out(plan, at, joint=kit.joint_gap, found=found, plant=plant)
    result = _described(done, planned - started, time.process_time() - planned)
    return result | {"pressed_N": round(plant.hardest, 2), "gives": _gives(found.job)}


def _given(what: str, arm: str, tool: str) -> Result:
    """A build of given blocks: every state with its posts, and what is left when all are gone."""
    assembly = _structure(what)
    started = time.process_time()
    plan = plan_assembly(assembly)
    planned = time.process_time()
    done = carry_out(plan, Workcell(arm, tool, hands=True), joint=0.0)
    result = _described(done, planned - started, time.process_time() - planned)
    hands = sum(step.by_hand for step in done.steps)
    return result | {"by_hand": hands} | ({"settled": _settled(done)} if done.complete else {})


def _structure(what: str) -> Assembly:
    """An example of given blocks, in the middle of the table."""
    if what.startswith("turned"):
        made = script("turned_wall", "turned_wall", bricks=64)()
        blocks = [replace(b, vertices=HALF_SIZE * b.vertices) for b in made.blocks]
        ends = np.array([[b.vertices.min(0), b.vertices.max(0)] for b in blocks])
        shift = np.array([*(ends[:, 0].min(0) + ends[:, 1].max(0))[:2] / 2, 0.0])
        blocks = [replace(b, vertices=b.vertices - shift) for b in blocks]
        return replace(made, blocks=tuple(blocks))
    if what.startswith("arch"):
        return script("arch", "arch", voussoirs=9)()
    size = {"count": 12, "seed": STONES_SEED, "spread": STONES_SPREAD}
    return script("stones", "stones", **size, cut=True)()


def _design(kind: str, what: str) -> tuple[CellDesign, Kit]:
    if kind in ("large", "props"):
        if kind == "props":
            (make, name), cell = PROPS[what], 0.04
        else:
            (make, cell), name = LARGE[what], DEFAULT_KIT
        kit = load_kit(name).at_pitch((cell, cell, cell))
        return CellDesign(what, make(), kit.pitch), kit
    design = read_design(EXAMPLES / what)
    assert isinstance(design, CellDesign)
    return design, load_kit(design.kit or DEFAULT_KIT).at_pitch(design.cell)


def _described(plan: Plan, planning: float, building: float) -> Result:
    arm = plan.arm
    return {
        "status": plan.status,
        "reason": plan.reason,
        "blocks": plan.blocks.used,
        "steps": len(plan.steps),
        "props": sum(s.prop and s.action == "place" for s in plan.steps),
        "planning_s": round(planning, 2),
        "building_s": round(building, 2),
        **(
            {}
            if arm is None
            else {
                "attempts": arm.attempts,
                "attempts_per_step": arm.attempts_per_step,
                "error_mean": arm.error_mean,
                "error_worst": arm.error_worst,
                "belief_error": arm.belief_error,
                "overlap": arm.overlap,
                "error_on_table": arm.error_on_table,
                "failures": to_plain(arm.failures),
                "places": arm.places,
                "robot_s": arm.seconds,
                "pitch": arm.pitch,
            }
        ),
    }


def _settled(plan: Plan) -> float:
    """How far a block moves when all of a finished structure are let go at once [m]."""
    record = plan.record
    assert record is not None
    pose = record.steps[-1].after
    kept = np.flatnonzero(pose[:, 2] > 0)
    owner = np.argsort(np.concatenate(record.objects))
    owner = np.repeat(np.arange(len(record.objects)), [len(c) for c in record.objects])[owner]
    half, density = (
        None if of_all is None else of_all[kept] for of_all in (record.half, record.density)
    )
    hull = None if record.hull is None else tuple(record.hull[k] for k in kept.tolist())
    scene = Scene(
        pose[kept, :3],
        np.zeros(len(kept)),
        owner[kept],
        len(kept),
        half,
        density,
        pose[kept, 3:],
        hull,
    )
    x, y, z = record.arm.base_position.tolist()
    base = x, y, z, record.arm.base_yaw
    after, still = _let_go(scene, get_arm(record.arm.name, record.arm.tool_name, base))
    moved = float(np.linalg.norm(after.position - scene.position, axis=1).max())
    return round(moved, 6) if still else math.inf


def _gives(job: Job) -> float | None:
    """How deep blocks are in one another where all are let go at the places where they are drawn
    [m]: by so much contacts of the simulation give under the weight of this structure."""
    kept = [piece for piece in job.pieces if not piece.prop]
    parts = [(n, piece, part) for n, piece in enumerate(kept) for part in piece.shape]
    turns = np.array([piece.pose[3:] for _, piece, _ in parts])
    hull = tuple(part.hull for *_, part in parts)
    scene = Scene(
        np.array([piece.target + piece.turn @ np.array(part.centre) for _, piece, part in parts]),
        np.zeros(len(parts)),
        np.array([n for n, *_ in parts]),
        len(parts),
        np.array([part.half for *_, part in parts]),
        np.array([piece.density for _, piece, _ in parts]),
        turns,
        hull if any(hull) else None,
    )
    after, _ = _let_go(scene, job.arm)
    first = [[n for n, *_ in parts].index(k) for k in range(len(kept))]
    bodies: list[list[Solid]] = []
    for row, piece in zip(first, kept, strict=True):
        turn = after.orientation[row]
        centre = quaternion_matrix(turn) @ np.array(piece.shape[0].centre)
        bodies.append(solids(piece.shape, np.array([*(after.position[row] - centre), *turn])))
    deepest = deepest_overlap(bodies)
    return None if deepest is None else round(deepest, 6)


def _let_go(scene: Scene, arm: Arm) -> tuple[Scene, bool]:
    """Blocks of a scene when they have come to rest, and whether they have."""
    after, turns, still = DynamicCell(arm).settle(scene)
    return after._replace(quaternion=turns), still


def _program(plan: Plan) -> Result:
    """What comes of the exported build, played open loop."""
    from learn2assemble.export.robot_programs import export_program, replay_program

    assert plan.record is not None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "program.csv"
        export_program(plan.record, "csv", file)
        run = replay_program(file, plan.record.arm.name)
    return {"program": {"same": run.same, "worst": float(run.error.max()), "fault": run.fault}}


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    groups: dict[str, dict[str, Result]] = {}
    for name, one in entries.items():
        kind, what, *rest = name.split("/")
        key = f"{kind}/{rest[-1]}" if kind in ("example", "coarse", "tracking") else kind
        groups.setdefault(key, {})["/".join([what, *rest])] = one
    for name, one in groups.pop("large", {}).items():
        rows.append(
            (
                name,
                "complete; 120 s, 1.05 attempts, 1 / 3 mm at 100 blocks",
                f"{one['status']}, {one['blocks']} blocks, "
                f"{one['planning_s'] + one['building_s']:.0f} s, {one.get('attempts_per_step')} "
                f"attempts, {1e3 * (one.get('error_mean') or 0):.2f} / "
                f"{1e3 * (one.get('error_worst') or 0):.2f} mm",
            )
        )
    asked = {
        "given": "all, <= 1.05 attempts, <= 1 mm",
        "props": "all",
        "program": "all",
        "faults": ">= 90 %",
        "noise": ">= 95 %, <= 2 mm",
        "guarded": ">= 95 %, <= 20 N",
        "seen": ">= 90 %",
        "coarse/touch": "say what it reaches",
        "coarse/blind": "say what it reaches",
        "worse": "not all, or worse errors",
        "late": ">= 95 %, <= 2 mm",
        "tracking/1": "all, <= 2 mm",
        "tracking/3": "all, <= 2 mm",
        "tracking/10": "say what it reaches",
        "tracking/30": "say what it reaches",
    }
    for key, group in sorted(groups.items()):
        done = sum(one["status"] == "complete" for one in group.values())
        left = [
            f"{name} ({one['reason']})"
            for name, one in group.items()
            if one["status"] != "complete"
        ]
        words = f"{done} of {len(group)}" + (f"; not: {'; '.join(left[:6])}" if left else "")
        if key == "given":
            most = max((one.get("attempts_per_step") or 0 for one in group.values()), default=0)
            worst = max((one.get("error_worst") or 0 for one in group.values()), default=0)
            words += f"; {most} attempts, {1e3 * worst:.2f} mm at most"
        if key.split("/")[0] in (*INEXACT, "seen"):
            worst = max((one.get("error_worst") or 0 for one in group.values()), default=0)
            deep = max((one.get("overlap") or 0 for one in group.values()), default=0)
            hard = max((one.get("pressed_N") or 0 for one in group.values()), default=0)
            words += f"; off by {1e3 * worst:.2f} mm, into another {1e3 * deep:.3f} mm at most"
            gives = max((one.get("gives") or 0 for one in group.values()), default=0)
            words += f" (contacts give by {1e3 * gives:.3f} mm)" if gives else ""
            if key == "guarded":
                there = max((one.get("error_on_table") or 0 for one in group.values()), default=0)
                words += f", on the table as it is by {1e3 * there:.2f} mm"
            words += f", pressed with {hard:.1f} N" if hard else ""
        rows.append((key, asked.get(key, "all"), words))
        if key == "program":
            worst = max(
                (one["program"]["worst"] for one in group.values() if "program" in one), default=0.0
            )
            rows.append(("blocks of exported programs off by", "2 mm", f"{1e3 * worst:.2f} mm"))
    return rows


FIGURES = Figures("learn2assemble-build-figures", names, entry, configuration, summary)
