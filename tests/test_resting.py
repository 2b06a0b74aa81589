"""What statics adds to the reading of a block that stands alone."""

from __future__ import annotations

import numpy as np
import pytest

from learn2assemble.geometry.hulls import hull_of, resting_turns
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    rotation_of,
    stepped_pose,
    yaw_matrix,
)
from learn2assemble.robot.bodies import Part, Shape, body_of
from learn2assemble.sensing.camera import DepthCamera, DepthNoise, looking
from learn2assemble.sensing.pictures import SimulatedCamera, still_scene
from learn2assemble.sensing.registration import Believed, Look, register
from learn2assemble.sensing.residuals import views_of
from learn2assemble.sensing.resting import LEVEL, TABLE, alone, rested

BOX: Shape = (Part((0.0, 0.0, 0.0), (0.04, 0.02, 0.015)),)
TETRAHEDRON = np.array([[0.0, 0, 0], [0.06, 0, 0], [0.02, 0.05, 0], [0.03, 0.02, 0.05]])
STONE: Shape = (
    Part(
        (0.0, 0.0, 0.0),
        tuple((np.ptp(TETRAHEDRON, axis=0) / 2).tolist()),
        hull_of(TETRAHEDRON - (TETRAHEDRON.min(0) + TETRAHEDRON.max(0)) / 2),
    ),
)


def standing(shape: Shape, face: int, yaw: float, x: float = 0.1, y: float = -0.05) -> np.ndarray:
    """float64[7]: pose of a block on one of the faces on which it rests."""
    body = body_of(shape)
    turn = yaw_matrix(yaw) @ resting_turns(body.hull, body.centre)[face].turn
    return np.array([x, y, -(body.points @ turn[2]).min(), *matrix_quaternion(turn)])


def raised(pose: np.ndarray, height: float) -> np.ndarray:
    return np.array([*pose[:2], pose[2] + height, *pose[3:]])


def some_covariance(rng: np.random.Generator) -> np.ndarray:
    spread = np.diag([5e-4] * 3 + [5e-3] * 3) @ rng.normal(size=(6, 6))
    return spread @ spread.T + np.diag([1e-8] * 3 + [1e-6] * 3)


@pytest.mark.parametrize("shape", [BOX, STONE], ids=["box", "tetrahedron"])
@pytest.mark.parametrize("face", range(3))
def test_a_reading_becomes_the_analytic_posterior(shape: Shape, face: int) -> None:
    """Against information added up: that of the reading, and that of the table."""
    rng = np.random.default_rng(face)
    for _ in range(30):
        true = standing(shape, face, rng.uniform(-3, 3))
        covariance = some_covariance(rng)
        off = np.linalg.cholesky(covariance) @ rng.normal(size=6)
        read = stepped_pose(true, off)
        table = np.diag([0, 0, TABLE**-2, LEVEL**-2, LEVEL**-2, 0])
        told = np.linalg.inv(covariance)
        expected = np.linalg.inv(told + table)
        # The plane says that the lean is undone, and the height with it.
        residual = np.array([0, 0, true[2] - read[2], *lean_undone(read, true)])
        step = expected @ (table @ residual)
        found = rested(read, covariance, shape)
        assert found is not None
        pose, kept = found
        assert np.allclose(kept, expected, rtol=1e-6, atol=1e-14)
        assert np.allclose(pose, stepped_pose(read, step), atol=1e-9)


def lean_undone(read: np.ndarray, true: np.ndarray) -> np.ndarray:
    """float64[3]: the shortest rotation that brings the vertical of a reading back, about x, y."""
    up = quaternion_matrix(read[3:]) @ quaternion_matrix(true[3:]).T @ [0.0, 0, 1]
    axis = np.cross(up, [0.0, 0, 1])
    sine = np.linalg.norm(axis)
    return axis * (np.arcsin(sine) / sine) if sine > 0 else axis


def test_what_contradicts_rest_is_left_as_it_was_read() -> None:
    """On an edge, in the air, in the table, upside down on a corner."""
    covariance = np.diag([5e-4] * 3 + [np.radians(0.5)] * 3) ** 2
    there = standing(BOX, 0, 0.4)
    leaning = np.array([*there[:3], 0, 0, 0, 0.0])
    leaning[3:] = matrix_quaternion(
        rotation_of(np.array([0.1, 0, 0])) @ quaternion_matrix(there[3:])
    )
    assert rested(leaning, covariance, BOX) is None
    for height in (0.01, -0.01):
        assert rested(raised(there, height), covariance, BOX) is None
    corner = standing(BOX, 0, 0.0)
    corner[3:] = matrix_quaternion(rotation_of(np.array([0.6, 0.6, 0.0])))
    assert rested(corner, covariance, BOX) is None


def test_little_is_changed_where_the_pictures_know_better() -> None:
    """A lean of a tenth of a degree that is read exactly stays."""
    exact = np.diag([1e-5] * 3 + [1e-4] * 3) ** 2
    there = standing(BOX, 0, 0.4)
    leans = stepped_pose(there, np.array([0, 0, 0, np.radians(0.1), 0, 0]))
    found = rested(leans, exact, BOX)
    assert found is not None
    assert np.abs(found[0] - leans).max() < 1e-5


def test_which_blocks_stand_alone() -> None:
    far, near = standing(BOX, 0, 0.0, 0.3), standing(BOX, 0, 0.0, 0.1 + 0.08 + 0.005)
    here = standing(BOX, 0, 0.0)
    assert alone([(BOX, here), (BOX, far)]).tolist() == [True, True]
    assert alone([(BOX, here), (BOX, near), (BOX, far)]).tolist() == [False, False, True]
    assert alone([(BOX, here), (BOX, raised(here, 0.03))]).tolist() == [False, False]
    assert not alone([(BOX, raised(here, 0.05))]).any(), "on something unseen"
    assert alone([]).shape == (0,)


def test_a_single_camera_reads_the_lean_of_a_block_that_stands_alone() -> None:
    """Errors of its pictures tilt a small face; the same pictures, with and without statics."""
    camera = DepthCamera(
        "above", (0.0, 0.0, 1.1, *looking(np.array([0.0, 0, -1]))), noise=DepthNoise()
    )
    leans: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(12):
        rng = np.random.default_rng(seed)
        there = standing(BOX, 0, rng.uniform(-3, 3), *rng.uniform(-0.1, 0.1, 2))
        picture = SimulatedCamera(camera, seed=seed).look([still_scene([(BOX, there)])])
        for stands in leans:
            seen = register(views_of([picture], [camera]), Believed("a", BOX, there, alone=stands))
            assert seen.look == Look.SEEN
            up = quaternion_matrix(seen.pose[3:]) @ quaternion_matrix(there[3:]).T @ [0.0, 0, 1]
            leans[stands].append(float(np.degrees(np.arccos(min(up[2], 1.0)))))
    assert np.median(leans[True]) < 0.7 * np.median(leans[False])
