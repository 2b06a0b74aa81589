"""A pile of stones, laid one by one.

``python examples/structures/stones.py [FOLDER [SEED [COUNT]]]``
"""

# pyright: reportAttributeAccessIssue=false
import sys
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial import HalfspaceIntersection

import learn2assemble as l2a
from learn2assemble.robot import scene

FRICTION = 0.8
DENSITY = 2500.0
"""[kg/m³]."""
STEP = 1e-3
"""Of the simulation [s]."""
REST = 1e-3
"""Speeds below which a stone counts as at rest, along or about any axis [m/s, rad/s]."""
DAMPING = 20.0
"""[1/s]."""
DEEPEST = 1e-4
"""Overlap of two stones in a heap that is read [m]."""
LONGEST = 1.0, 5.0
"""How long each stone is waited for, and all of them at the end [s]."""
SIDES = (1, 0), (0, 1), (-1, 0), (0, -1)
PUSH, PUSHED, ROCKS = 0.1, 0.3, 3e-4
"""Laid piles are tried with a sideways acceleration [g] to each side, so long [s], and no stone may
get farther than this [m]."""
REACH, WIDER = 2.0, 1.02
"""How far from the middle stones of a laid pile may come to rest, in spreads, and by how much more
with every try."""


def stone(rng: np.random.Generator, number: int) -> l2a.Block:
    """The hull of 14 random points on an ellipsoid, 3 to 8 cm long, its centre of mass at zero."""
    points = rng.normal(size=(14, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= rng.uniform(0.6, 1.0, 3)
    points *= rng.uniform(0.03, 0.08) / np.ptp(points, axis=0).max()
    made = l2a.hull_block(f"stone{number}", points)
    return l2a.hull_block(made.id, made.vertices - made.centroid, density=DENSITY)


def cut_stone(rng: np.random.Generator, number: int) -> l2a.Block:
    """A stone with six plane faces, 5 to 9 cm long, none of them parallel but by chance."""
    half = rng.uniform([0.032, 0.028, 0.022], [0.045, 0.038, 0.03])
    normals = np.vstack([np.eye(3), -np.eye(3)]) + rng.normal(scale=0.09, size=(6, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = np.column_stack([normals, -np.tile(half, 2)])
    made = l2a.hull_block(
        f"stone{number}", HalfspaceIntersection(planes, np.zeros(3)).intersections
    )
    return l2a.hull_block(made.id, made.vertices - made.centroid, density=DENSITY)


def stones(
    count: int = 20,
    seed: int = 0,
    spread: float = 0.03,
    *,
    cut: bool = False,
    laid: bool = False,
) -> l2a.Assembly:
    """A pile: stones put down one by one on the ground or on what lies there already.

    A heap of stones as they fell need not have an order in which it can be built: stones that come
    later push those before them, which then lean on them as much as they carry them. A mason lays
    a stone so that it moves no other one, and takes it up again where it rocks.

    Args:
        count: how many.
        seed: of their shapes and of where they come down.
        spread: standard deviation of where they come down about the middle [m].
        cut: they have plane faces that a cup can hold.
        laid: as a mason lays them; else as they fell.
    """
    rng = np.random.default_rng(seed)
    shapes = [(cut_stone if cut else stone)(rng, k) for k in range(count)]
    poses = (_laid if laid else _fallen)(rng, shapes, spread)
    blocks = [
        l2a.hull_block(s.id, _placed(s, at), density=DENSITY, kind="stone")
        for s, at in zip(shapes, poses, strict=True)
    ]
    return l2a.Assembly(tuple(blocks), friction=FRICTION, name=f"stones_{count}_{seed}")


def _fallen(rng: np.random.Generator, shapes: list[l2a.Block], spread: float) -> np.ndarray:
    """float64[n, 7]: poses of stones that were let go one after the other."""
    count = len(shapes)
    model, data = _scene(shapes)
    pose = data.qpos.reshape(-1, 7)
    for k in range(count):
        pose[k] = _above(rng, shapes, pose[:k], spread)
        model.body_gravcomp[k + 1] = 0.0
        _settle(model, data, k + 1, LONGEST[k + 1 == count])
    # MuJoCo may lose a contact for an instant; the heap is read where none is lost.
    for _ in range(round(LONGEST[1] / STEP)):
        if np.abs(data.qvel).max() < 10 * REST and data.contact.dist.min(initial=0) > -DEEPEST:
            break
        mujoco.mj_step(model, data)
    return pose.copy()


def _laid(rng: np.random.Generator, shapes: list[l2a.Block], spread: float) -> np.ndarray:
    """float64[n, 7]: poses of stones that lie firmly, each where those before it did not move."""
    poses = np.empty((0, 7))
    for k in range(len(shapes)):
        # While a stone finds its place those before it are fixed.
        alone, whole = _scene(shapes[: k + 1], poses), _scene(shapes[: k + 1])
        reach, lies = REACH * spread, False
        while not lies:
            model, data = alone
            model.body_gravcomp[-1], model.opt.gravity[:2] = 0.0, 0.0
            mujoco.mj_resetData(model, data)
            data.qpos[:] = _above(rng, shapes[: k + 1], poses, spread)
            lies = _settle(model, data, 1, LONGEST[0])
            lies = lies and bool(np.linalg.norm(data.qpos[:2]) < reach)
            new = np.vstack([poses, data.qpos])
            lies = lies and _firm(*alone, new[-1:]) and _firm(*whole, new)
            reach *= WIDER
        poses = new
    return poses


def _firm(model: mujoco.MjModel, data: mujoco.MjData, poses: np.ndarray) -> bool:
    """Whether nothing rocks that moves in a scene, at poses float64[n, 7], when it is pushed."""
    model.body_gravcomp[:], damping = 0.0, model.dof_damping.copy()
    model.dof_damping[:], firm = 0.0, True
    for side in SIDES:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = poses.ravel()
        model.opt.gravity[:2] = PUSH * np.abs(model.opt.gravity[2]) * np.array(side)
        for _ in range(round(PUSHED / STEP)):
            mujoco.mj_step(model, data)
        there = data.qpos.reshape(-1, 7)
        firm = bool(np.abs(there[:, :3] - poses[:, :3]).max() < ROCKS)
        if not firm:
            break
    model.opt.gravity[:2], model.dof_damping[:] = 0.0, damping
    return firm


def _above(
    rng: np.random.Generator, shapes: list[l2a.Block], poses: np.ndarray, spread: float
) -> np.ndarray:
    """float64[7]: a pose of the next stone, turned at random, above those that lie there."""
    shape, turn = shapes[len(poses)], rng.normal(size=4)
    at = np.array([*rng.normal(scale=spread, size=2), 0.0, *(turn / np.linalg.norm(turn))])
    corners = _placed(shape, at)
    low, high = corners[:, :2].min(0), corners[:, :2].max(0)
    lying = [_placed(other, pose) for other, pose in zip(shapes, poses, strict=False)]
    under = [
        other[:, 2].max()
        for other in lying
        if (other[:, :2].min(0) < high).all() and (other[:, :2].max(0) > low).all()
    ]
    at[2] = max(under, default=0.0) + 1e-3 - corners[:, 2].min()
    return at


def _scene(
    shapes: list[l2a.Block], fixed: np.ndarray | tuple[()] = ()
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Bodies in the order of the stones, after the world: those that are fixed at poses
    float64[n, 7], and others that wait high up and do not fall."""
    spec = mujoco.MjSpec()
    scene.set_options(spec, STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    surface = scene.ContactSurface(friction=FRICTION)
    scene.add_ground(spec, "ground", surface)
    for k, shape in enumerate(shapes):
        spec.add_mesh(name=shape.id, uservert=shape.vertices.ravel())
        if k < len(fixed):
            body = spec.worldbody.add_body(name=shape.id, pos=fixed[k][:3], quat=fixed[k][3:])
        else:
            body = spec.worldbody.add_body(name=shape.id, pos=[k, 0, 10], gravcomp=1.0)
            body.add_freejoint()
        geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=shape.id, density=DENSITY)
        scene.set_contact(geom, surface)
    model = spec.compile()
    # Nothing may fall asleep while it still slides.
    model.opt.enableflags = 0
    # Stones that are let go lose speed as in a thick liquid, so that none is flung off the heap.
    model.dof_damping[:] = DAMPING * model.dof_M0
    return model, mujoco.MjData(model)


def _settle(model: mujoco.MjModel, data: mujoco.MjData, falling: int, longest: float) -> bool:
    """Simulate until the first ``falling`` stones are at rest, or so long [s]: whether they are."""
    calm = 0
    for _ in range(round(longest / STEP)):
        mujoco.mj_step(model, data)
        calm = calm + 1 if np.abs(data.qvel[: 6 * falling]).max() < REST else 0
        if calm * STEP > 0.1:
            return True
    return False


def _placed(shape: l2a.Block, pose: np.ndarray) -> np.ndarray:
    """float64[V, 3]: vertices of a stone at a position and quaternion."""
    return shape.vertices @ scene.rotation_matrix(pose[3:]).T + pose[:3]


def main() -> None:
    """Write the pile, its plan, and the page and picture of the plan."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/stones")
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 20
    assembly = stones(count, seed, laid=True)
    out.mkdir(parents=True, exist_ok=True)
    l2a.write_assembly(assembly, out / f"{assembly.name}.json", overwrite=True)
    print(assembly.name, l2a.check(assembly).verdict)
    plan = l2a.build(assembly, progress=print)
    print(plan.status, plan.reason or "")
    print(*plan.save(out).values(), sep="\n")


if __name__ == "__main__":
    main()
