"""What depth cameras tell of blocks, and a calibration of cameras: ``results/sensing.json``.

Everything is simulated: pictures are those of :mod:`learn2assemble.sensing.pictures`, with the
noise of a camera as a layout has it by default (1.5 mm a pixel at 1 m, edges lost, an error that
stays). A block is believed to be 1 mm (standard deviation along x and y) and 1 degree from where it
is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from l2a_lab.measured import Figures, Result
from learn2assemble.acting.belief import step_between
from learn2assemble.cell.pieces import symmetries
from learn2assemble.geometry.hulls import hull_of
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
    yaw_quaternion,
)
from learn2assemble.robot.bodies import Part, Shape
from learn2assemble.sensing.calibration import Sighting, calibrated, table_sightings
from learn2assemble.sensing.camera import DepthCamera, DepthNoise, looking, rotation
from learn2assemble.sensing.pictures import SimulatedCamera, still_scene
from learn2assemble.sensing.registration import Believed, Look, register
from learn2assemble.sensing.residuals import views_of
from learn2assemble.sensing.resting import alone
from learn2assemble.sensing.search import find

SAMPLES, SEEDS = 40, 8
NEAR, NEAR_TURN = 1e-3, math.radians(1.0)
"""How far a block is from where it is believed to be: standard deviations [m], [rad]."""
OFF, OFF_TURN = 3e-3, math.radians(1.0)
"""By how much cameras are off before they are calibrated [m], [rad]."""
PLACED, CLOSE = 4e-4, 3e-3
"""How exactly the arm puts blocks down: standard deviations [m], [rad]."""
PLACES = ((-0.15, -0.1), (0.15, -0.1), (0.0, 0.12), (-0.15, 0.15), (0.15, 0.15), (0.0, -0.18))
"""Where the bricks of a calibration are put [m]."""
BRICK: Shape = (Part((0.0, 0.0, 0.0), (0.04, 0.02, 0.015)),)
CUBE: Shape = (Part((0.0, 0.0, 0.0), (0.02, 0.02, 0.02)),)
_CORNERS = np.array([[-4, -2.5, -2], [4, -2.5, -2], [-4, 2.5, -2], [4, 2.5, -2], [-4, -2.5, 2]])
WEDGE: Shape = (
    Part((0.0, 0.0, 0.0), (0.04, 0.025, 0.02), hull_of(np.vstack([_CORNERS, [-4, 2.5, 2]]) / 100)),
)
SHAPES: dict[str, Shape] = {"brick 80 x 40 x 30 mm": BRICK, "cube of 40 mm": CUBE, "wedge": WEDGE}
TURNS: dict[Shape, tuple[np.ndarray, ...]] = {one: symmetries(one) for one in SHAPES.values()}


def camera(name: str, x: float, y: float, z: float, noise: DepthNoise | None = None) -> DepthCamera:
    """One that looks at the middle of the table."""
    pose = (x, y, z, *looking(np.array([-x, -y, -z])))
    return DepthCamera(name, pose, noise=noise or DepthNoise())


FINE = DepthNoise(2e-4, 3e-4, 1e-4)
"""An industrial camera of structured light."""
RIGS = {
    "one camera": (camera("right", 0.6, 0.5, 0.8),),
    "two cameras": (camera("right", 0.6, 0.5, 0.8), camera("left", -0.6, -0.5, 0.8)),
    "one camera above": (camera("above", 0.0, 0.0, 1.1),),
    "two fine cameras": (
        camera("right", 0.6, 0.5, 0.8, noise=FINE),
        camera("left", -0.6, -0.5, 0.8, noise=FINE),
    ),
}
Scene = Callable[[np.random.Generator, Shape], tuple[np.ndarray, list[tuple[Shape, np.ndarray]]]]
"""Makes the pose float64[7] of the block that is looked for, and the other ones."""


def names() -> list[str]:
    """Every measurement: kind / what / with which cameras."""
    found = [f"alone/{shape}/{rig}" for shape in SHAPES for rig in RIGS]
    found += [f"{kind}/{BRICKS}/{rig}" for kind in ("pile", "row") for rig in RIGS]
    found += [f"lost/two bricks beside a wall/{rig}" for rig in RIGS]
    found += [f"look/{count} bricks/{rig}" for count in (40, 100) for rig in RIGS]
    return found + [f"calibrated/{seed}/{rig}" for seed in range(SEEDS) for rig in RIGS]


BRICKS = next(iter(SHAPES))


def entry(name: str) -> Result:
    """One measurement by its name."""
    kind, what, rig = name.split("/")
    cameras = RIGS[rig]
    if kind == "lost":
        return _lost(cameras)
    if kind == "look":
        return _look(int(what.split()[0]), cameras)
    if kind == "calibrated":
        told = calibration(int(what), cameras)._asdict()
        return {name: told[name] for name in ("before_mm", "after_mm", "readings")}
    return _poses(SHAPES[what], SCENES[kind], cameras)


# ---------------------------------------------------------------- scenes


def resting(shape: Shape, x: float, y: float, yaw: float, below: float = 0.0) -> np.ndarray:
    """float64[7]: pose of a block on something of a height [m]."""
    return np.array([x, y, below + shape[0].half[2], *yaw_quaternion(yaw)])


def _alone(
    rng: np.random.Generator, shape: Shape
) -> tuple[np.ndarray, list[tuple[Shape, np.ndarray]]]:
    x, y = rng.uniform(-0.15, 0.15, 2).tolist()
    return resting(shape, x, y, rng.uniform(-3, 3)), []


def _beside(
    there: np.ndarray, shape: Shape, x: float, y: float, z: float = 0.0
) -> tuple[Shape, np.ndarray]:
    """A block moved along the axes of another one [m]."""
    pose = there.copy()
    pose[:3] += quaternion_matrix(there[3:]) @ [x, y, z]
    return shape, pose


def _pile(
    rng: np.random.Generator, shape: Shape
) -> tuple[np.ndarray, list[tuple[Shape, np.ndarray]]]:
    """On two layers of bricks, a wall of three behind it, one of its height 5 mm beside it."""
    x, y = rng.uniform(-0.1, 0.1, 2).tolist()
    there = resting(shape, x, y, rng.uniform(-3, 3), 0.06)
    x, y, z = (2 * k for k in shape[0].half)
    joint = 1e-4
    others = [_beside(there, shape, k * (x + joint), 0, -n * z) for n in (1, 2) for k in (-1, 0, 1)]
    others += [
        _beside(there, shape, k * (x + joint), y + joint, n * z)
        for n in (-2, -1, 0)
        for k in (-1, 0, 1)
    ]
    return there, [*others, _beside(there, shape, x + 0.005, 0)]


def _row(
    rng: np.random.Generator, shape: Shape
) -> tuple[np.ndarray, list[tuple[Shape, np.ndarray]]]:
    """In a row of bricks, joints of 0.1 mm on both sides."""
    there, _ = _alone(rng, shape)
    wide = 2 * shape[0].half[0] + 1e-4
    return there, [_beside(there, shape, side * wide, 0) for side in (-1, 1)]


SCENES: dict[str, Scene] = {"alone": _alone, "pile": _pile, "row": _row}


# ---------------------------------------------------------------- measurements


def _apart(one: np.ndarray, two: np.ndarray) -> tuple[float, float]:
    """How far two poses are apart [mm], [degrees]."""
    turn = quaternion_matrix(one[3:]) @ quaternion_matrix(two[3:]).T
    angle = math.acos(float(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    return 1e3 * float(np.linalg.norm(one[:3] - two[:3])), math.degrees(angle)


def _looks(cameras: tuple[DepthCamera, ...], seed: int) -> list[SimulatedCamera]:
    return [SimulatedCamera(one, seed=1000 * seed + k) for k, one in enumerate(cameras)]


def _believed(rng: np.random.Generator, true: np.ndarray) -> np.ndarray:
    pose = true.copy()
    pose[:2] += rng.normal(0, NEAR, 2)
    pose[3:] = quaternion_product(yaw_quaternion(rng.normal(0, NEAR_TURN)), pose[3:])
    return pose


def _poses(shape: Shape, scene: Scene, cameras: tuple[DepthCamera, ...]) -> Result:
    """Errors of one block in many scenes."""
    far, turned, spread, seconds = (list[float]() for _ in range(4))
    for seed in range(SAMPLES):
        rng = np.random.default_rng(seed)
        true, others = scene(rng, shape)
        solids = still_scene([(shape, true), *others])
        pictures = [one.look([solids]) for one in _looks(cameras, seed)]
        there = _believed(rng, true)
        stands = alone([(shape, there), *others])
        believed = Believed("a", shape, there, TURNS[shape], alone=bool(stands[0]))
        started = time.process_time()
        seen = register(views_of(pictures, cameras), believed)
        seconds.append(time.process_time() - started)
        if seen.look == Look.SEEN:
            one, two = _apart(seen.pose, true)
            far.append(one)
            turned.append(two)
            spread.append(1e3 * math.sqrt(float(np.trace(seen.covariance[:3, :3]))))
    return {
        "samples": SAMPLES,
        "seen": len(far),
        "mm": [round(float(v), 4) for v in np.percentile(far, (50, 95, 100))],
        "deg": [round(float(v), 4) for v in np.percentile(turned, (50, 95, 100))],
        "told_mm": round(float(np.median(spread)), 4),
        "seconds": round(float(np.median(seconds)), 5),
    }


def _wall(count: int) -> list[tuple[Shape, np.ndarray]]:
    """Bricks in rows of five, two deep."""
    found: list[tuple[Shape, np.ndarray]] = []
    for k in range(count):
        layer, place = divmod(k, 10)
        x, y = 0.0801 * (place % 5 - 2), 0.0401 * (place // 5)
        found.append((BRICK, resting(BRICK, x, y, 0.0, 0.03 * layer)))
    return found


def _lost(cameras: tuple[DepthCamera, ...]) -> Result:
    """Two bricks somewhere before a wall of 20, every second time one of them on its side."""
    hits, wrong, seconds = 0, 0, list[float]()
    for seed in range(SAMPLES // 2):
        rng = np.random.default_rng(seed)
        places = [
            resting(BRICK, rng.uniform(-0.2, 0.2), -0.1 - 0.12 * k, rng.uniform(-3, 3))
            for k in (0, 1)
        ]
        if seed % 2:
            onto = rotation(np.array([math.pi / 2, 0, 0]))
            places[0][3:] = matrix_quaternion(quaternion_matrix(places[0][3:]) @ onto)
            places[0][2] = BRICK[0].half[1]
        wall = _wall(20)
        solids = still_scene([*wall, *((BRICK, pose) for pose in places)])
        views = views_of([one.look([solids]) for one in _looks(cameras, seed)], cameras)
        lost = [Believed(name, BRICK, None, TURNS[BRICK]) for name in "ab"]
        started = time.process_time()
        found = find(views, lost, wall)
        seconds.append(time.process_time() - started)
        for one in found:
            if min(_apart(one.pose, pose)[0] for pose in places) < 3:
                hits += 1
            else:
                wrong += 1
    count = 2 * (SAMPLES // 2)
    took = round(float(np.median(seconds)), 4)
    return {"samples": count, "found": hits, "wrong": wrong, "seconds": took}


def _look(count: int, cameras: tuple[DepthCamera, ...]) -> Result:
    """Seconds of the processor for a look at a wall: pictures (simulated), and poses."""
    wall, rng, seen = _wall(count), np.random.default_rng(0), 0
    shots, poses = list[float](), list[float]()
    devices = _looks(cameras, 0)
    for _ in range(6):
        solids = still_scene(wall)
        started = time.process_time()
        pictures = [one.look([solids]) for one in devices]
        shots.append(time.process_time() - started)
        started, seen = time.process_time(), 0
        views = views_of(pictures, cameras)
        for k, (shape, pose) in enumerate(wall):
            found = register(views, Believed(str(k), shape, _believed(rng, pose), TURNS[shape]))
            seen += found.look == Look.SEEN
        poses.append(time.process_time() - started)
    return {
        "bricks": count,
        "seen": seen,
        "pictures_s": round(float(np.median(shots[1:])), 4),
        "seconds": round(float(np.median(poses[1:])), 4),
    }


def _off_cameras(seed: int, cameras: Sequence[DepthCamera]) -> list[SimulatedCamera]:
    """Cameras that truly are 3 mm and 1 degree from where they are taken to be, somewhere."""
    rng, devices = np.random.default_rng(seed), list[SimulatedCamera]()
    for k, one in enumerate(cameras):
        shift, axis = rng.normal(size=3), rng.normal(size=3)
        error = [*(OFF * shift / np.linalg.norm(shift)), *(OFF_TURN * axis / np.linalg.norm(axis))]
        devices.append(SimulatedCamera(one, error, 1000 * seed + k))
    return devices


class CalibratedRig(NamedTuple):
    """Cameras that were 3 mm and 1 degree off."""

    cameras: tuple[DepthCamera, ...]
    """As calibrated."""
    off: tuple[tuple[float, ...], ...]
    """By how much each truly is elsewhere, as :class:`Disturbance` has it."""
    before_mm: float
    after_mm: float
    """How far what they see is from where it is, see :func:`_wrong`."""
    readings: int


def calibration(seed: int, cameras: Sequence[DepthCamera]) -> CalibratedRig:
    """Cameras calibrated by the empty table and by bricks that the arm has put down, alone.

    Args:
        seed: of how far they are off, and of how exactly the arm puts the bricks down.
        cameras: where they are taken to be.
    """
    devices = _off_cameras(seed, cameras)
    rng, readings = np.random.default_rng([seed, 1]), list[Sighting]()
    base = np.array([0.0, -0.5, 0.0, *yaw_quaternion(math.pi / 2)])
    # A camera that is off sees the table lean; that comes first.
    empty = still_scene([])
    for one, device in zip(cameras, devices, strict=True):
        readings += table_sightings(device.look([empty]), one)[::4]
    level = calibrated(base, cameras, readings).cameras
    for number, (x, y) in enumerate(PLACES):
        told = resting(BRICK, x, y, 0.5 * number)
        true = told.copy()
        true[:2] += rng.normal(0, PLACED, 2)
        true[3:] = quaternion_product(yaw_quaternion(rng.normal(0, CLOSE)), true[3:])
        solids = still_scene([(BRICK, true)])
        for one, device in zip(level, devices, strict=True):
            picture = device.look([solids])
            views = views_of([picture], [one])
            found = find(views, [Believed("a", BRICK, None, TURNS[BRICK])], [])
            if not found:
                continue
            near = np.array([*found[0].pose[:3], *told[3:]])
            seen = register(views, Believed("a", BRICK, near, TURNS[BRICK]))
            if seen.look != Look.SEEN:
                continue
            for arm in np.array([[0.03, 0, 0.01], [-0.03, 0.01, 0], [0.0, 0, 0]]):
                here = seen.pose[:3] + quaternion_matrix(seen.pose[3:]) @ arm
                there = told[:3] + quaternion_matrix(told[3:]) @ arm
                local = (here - one.position) @ one.turn
                readings.append(Sighting(one.name, local, there))
    found = calibrated(base, cameras, readings).cameras
    off = tuple(
        tuple(step_between(np.array(one.pose), np.array(device.camera.pose)).tolist())
        for one, device in zip(found, devices, strict=True)
    )
    before, after = (_wrong(some, devices) for some in (cameras, found))
    return CalibratedRig(found, off, before, after, len(readings))


def _wrong(told: Sequence[DepthCamera], devices: Sequence[SimulatedCamera]) -> float:
    """How far from where it is cameras take something at most that is on or above the table
    [mm]."""
    points = np.array([[x, y, z] for x in (-0.2, 0, 0.2) for y in (-0.2, 0, 0.2) for z in (0, 0.1)])
    worst = 0.0
    for one, device in zip(told, devices, strict=True):
        local = (points - device.camera.position) @ device.camera.turn
        here = one.position + local @ one.turn.T
        worst = max(worst, float(np.linalg.norm(here - points, axis=1).max()))
    return round(1e3 * worst, 3)


# ---------------------------------------------------------------- what was asked


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    rows: list[tuple[str, str, str]] = []
    asked = {
        "alone": "0.7 mm, 0.5 degrees (median)",
        "pile": "1.5 mm (median)",
        "row": "-",
        "lost": "-",
        "look": "0.3 s",
    }
    calibrations: dict[str, list[Result]] = {}
    for name, one in entries.items():
        kind, what, rig = name.split("/")
        if kind == "calibrated":
            calibrations.setdefault(rig, []).append(one)
            continue
        if kind == "lost":
            got = f"{one['found']} of {one['samples']} found, {one['wrong']} wrong"
        elif kind == "look":
            got = f"{one['seconds']:.2f} s for {one['seen']} seen of {one['bricks']}"
            got += f", pictures {one['pictures_s']:.2f} s"
        else:
            (a, b, _), (c, d, _) = one["mm"], one["deg"]
            got = f"{a:.2f} mm, {c:.2f} degrees; 95 %: {b:.2f} mm, {d:.2f}"
            got += f"; {one['seen']} of {one['samples']} seen"
        rows.append((f"{kind}: {what}, {rig}", asked[kind], got))
    for rig, some in calibrations.items():
        before, after = ([one[f"{k}_mm"] for one in some] for k in ("before", "after"))
        got = f"{np.median(before):.1f} mm before, {np.median(after):.2f} mm after"
        rows.append(
            (f"calibrated, {len(some)} times, {rig}", "-", f"{got}, {max(after):.2f} worst")
        )
    return rows


def configuration() -> Result:
    """Of all measurements."""
    noise = DepthNoise()
    return {
        "believed_mm_deg": [1e3 * NEAR, math.degrees(NEAR_TURN)],
        "camera_off_mm_deg": [1e3 * OFF, math.degrees(OFF_TURN)],
        "noise": [noise.floor, noise.growth, noise.waves, noise.edges, noise.dropout],
        "fine_noise": [FINE.floor, FINE.growth, FINE.waves, FINE.edges, FINE.dropout],
        "cameras": {rig: [list(one.pose) for one in some] for rig, some in RIGS.items()},
        "resolution": list(DepthCamera.resolution),
        "frames": DepthCamera.frames,
    }


FIGURES = Figures("learn2assemble-sensing", names, entry, configuration, summary)
