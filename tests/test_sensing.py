"""Depth cameras, and poses of blocks from their pictures (``docs/sensing.md``)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from brick_data import BRICK, CORNER, TURNS, lying, off_by, shifted
from learn2assemble.cell.site import read_site
from learn2assemble.errors import InputError
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
from learn2assemble.sensing.pictures import SimulatedCamera, still_scene, true_depth
from learn2assemble.sensing.registration import (
    ENOUGH,
    Believed,
    Look,
    Seen,
    register,
    what_is_told,
)
from learn2assemble.sensing.residuals import views_of
from learn2assemble.sensing.resting import LEVEL, TABLE, alone, rested

WEDGE = hull_of(np.array([[0, 0, 0], [8, 0, 0], [0, 5, 0], [8, 5, 0], [0, 0, 4], [0, 5, 4]]) / 100)
SHIFTED = tuple((np.array(WEDGE.corners) - [0.04, 0.025, 0.02]).tolist())


def looked(camera: DepthCamera, solids: list, believed: Believed, seed: int = 0) -> Seen:
    model, data = still_scene(solids)
    picture = SimulatedCamera(camera, seed=seed).look([(model, data)])
    return register(views_of([picture], [camera]), believed)


# ---------------------------------------------------------------- pictures


def test_a_picture_shows_the_table_and_what_stands_on_it() -> None:
    camera = DepthCamera("above", (0.0, 0.0, 1.0, *looking(np.array([0.0, 0.0, -1.0]))), (80, 60))
    depth = true_depth([still_scene([(BRICK, lying(0.0, 0.0, 0.0))])], camera)
    assert depth[30, 40] == pytest.approx(0.97, abs=1e-6)
    assert depth[0, 0] == pytest.approx(1.0, abs=1e-6)
    # Straight down, x of the world is to the right and y up.
    rows, columns = np.nonzero(depth < 0.99)
    assert np.ptp(columns) > 1.5 * np.ptp(rows)
    points = camera.points(depth)
    assert np.abs(camera.project(points)[..., 2] - depth).max() < 1e-9


def test_noise_grows_with_distance_and_edges_are_lost() -> None:
    noise = DepthNoise(0.001, 0.002, 0.0, 1.0, 0.0)
    for height, sigma in ((1.0, 0.003), (2.0, 0.009)):
        pose = (0.0, 0.0, height, *looking(np.array([0.0, 0.0, -1.0])))
        camera = DepthCamera("above", pose, frames=1, noise=noise)
        depth = SimulatedCamera(camera).look([still_scene([(BRICK, lying(0.0, 0.0, 0.0))])]).depth
        assert np.std(depth[:100]) == pytest.approx(sigma, rel=0.05)
        assert 50 < (depth == 0).sum() < 1000
    many = SimulatedCamera(replace(camera, frames=9)).look([still_scene([])]).depth
    assert np.std(many[:100]) < 0.5 * sigma
    assert many.dtype == np.float32


def test_a_camera_in_a_block_and_one_that_looks_away_see_nothing() -> None:
    model, data = still_scene([(BRICK, lying(0.0, 0.0, 0.0))])
    inside = DepthCamera("inside", (0.0, 0.0, 0.015, *looking(np.array([1.0, 0.0, 0.0]))))
    away = DepthCamera("away", (0.0, 0.0, 1.0, *looking(np.array([0.3, 0.0, 1.0]))))
    for camera in (inside, away):
        picture = SimulatedCamera(camera).look([(model, data)])
        assert picture.blind
        seen = register(views_of([picture], [camera]), Believed("a", BRICK, lying(0.0, 0.0, 0.0)))
        assert seen.look == Look.HIDDEN


# ---------------------------------------------------------------- poses


def test_a_block_alone_is_found_within_its_covariance() -> None:
    rng = np.random.default_rng(0)
    far, turned, spread = [], [], []
    for seed in range(24):
        true = lying(*rng.uniform(-0.15, 0.15, 2), rng.uniform(-3, 3))
        near = shifted(true, rng.normal(0, 0.002, 2))
        seen = looked(CORNER, [(BRICK, true)], Believed("a", BRICK, near, TURNS), seed)
        assert seen.look == Look.SEEN
        off = off_by(seen.pose, true)
        far.append(np.linalg.norm(off[:3]))
        turned.append(np.linalg.norm(off[3:]))
        spread.append(off @ np.linalg.solve(seen.covariance, off) / 6)
    assert np.median(far) < 0.0007
    assert np.degrees(np.median(turned)) < 0.8
    assert 0.2 < np.mean(spread) < 2.5


def test_an_equivalent_pose_near_the_one_believed_is_returned() -> None:
    true = lying(0.05, -0.04, 0.3)
    for turn in TURNS:
        other = looked(CORNER, [(BRICK, true)], Believed("a", BRICK, true, TURNS))
        asked = true.copy()
        asked[3:] = matrix_quaternion(quaternion_matrix(true[3:]) @ turn)
        seen = looked(CORNER, [(BRICK, true)], Believed("a", BRICK, asked, TURNS))
        assert np.abs(off_by(seen.pose, asked)).max() < 0.02
        assert np.abs(seen.pose[:3] - other.pose[:3]).max() < 3e-4


def test_a_block_of_no_box_is_found() -> None:
    shape = (Part((0.0, 0.0, 0.0), (0.04, 0.025, 0.02), hull_of(np.array(SHIFTED))),)
    true = lying(0.03, 0.02, 0.7, 0.02)
    near = shifted(true, [0.003, -0.002])
    seen = looked(CORNER, [(shape, true)], Believed("a", shape, near))
    assert seen.look == Look.SEEN
    assert np.linalg.norm(seen.pose[:3] - true[:3]) < 0.0015


def test_what_a_picture_cannot_say_stays_open() -> None:
    """Along a wall of bricks that touch, nothing tells where one ends."""
    true = lying(0.0, 0.0, 0.4)
    along = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    wall = [(BRICK, shifted(true, side * 0.0801 * along)) for side in (-1, 1)]
    alone = looked(CORNER, [(BRICK, true)], Believed("a", BRICK, true, TURNS))
    near = shifted(true, 0.001 * along)
    seen = looked(CORNER, [(BRICK, true), *wall], Believed("a", BRICK, near, TURNS))
    assert seen.look == Look.SEEN
    assert along @ seen.covariance[:3, :3] @ along > 0.002**2
    assert along @ alone.covariance[:3, :3] @ along < 0.0005**2
    widths, axes = np.linalg.eigh(seen.covariance[:3, :3])
    assert widths[1] < 0.0008**2
    assert abs(axes[:, 2] @ along) > 0.99
    assert np.linalg.norm(seen.pose[:3] - true[:3]) < 0.003


def test_the_outline_of_a_neighbour_is_not_taken_for_that_of_a_block() -> None:
    """A small brick beside a longer one of the same height, both seen from rather far."""
    small: Shape = (Part((0.0, 0.0, 0.0), (0.016, 0.016, 0.00955)),)
    long: Shape = (Part((0.0, 0.0, 0.0), (0.032, 0.016, 0.00955)),)
    fine = DepthNoise(2e-4, 3e-4, 1e-4)
    cameras = [
        DepthCamera(f"{y}", (0.5, y, 0.8, *looking(np.array([-0.5, -y, -0.8]))), noise=fine)
        for y in (0.6, -0.6)
    ]
    true = np.array([0.032, 0.196, 0.0478, 1.0, 0.0, 0.0, 0.0])
    near = [
        (long, shifted(true, [0.0, 0.0321])),
        (small, shifted(true, [-0.0182, -0.0316])),
        (small, shifted(true, [0.0158, -0.0317])),
    ]
    scene = still_scene([(small, true), *near])
    for seed in range(6):
        pictures = [SimulatedCamera(camera, seed=seed).look([scene]) for camera in cameras]
        believed = Believed("a", small, shifted(true, [3e-4, 1e-4]), search=(0.004, 0.05))
        seen = register(views_of(pictures, cameras), believed)
        assert seen.look == Look.SEEN
        off = off_by(seen.pose, true)
        assert np.linalg.norm(off[:3]) < 0.002
        assert off[:3] @ np.linalg.solve(seen.covariance[:3, :3], off[:3]) < 16


def test_blocks_that_are_not_there_and_blocks_behind_others_are_told_apart() -> None:
    true = lying(0.0, 0.0, 0.2)
    gone = looked(CORNER, [], Believed("a", BRICK, true, TURNS))
    assert gone.look == Look.ABSENT
    wide = (Part((0.0, 0.0, 0.0), (0.1, 0.1, 0.01)),)
    above = np.array([0.06, 0.05, 0.13, 1.0, 0.0, 0.0, 0.0])
    hidden = looked(CORNER, [(BRICK, true), (wide, above)], Believed("a", BRICK, true, TURNS))
    assert hidden.look == Look.HIDDEN
    assert np.array_equal(hidden.pose, true)


def test_what_is_not_known_of_the_camera_is_not_known_of_the_block() -> None:
    true = lying(0.0, 0.0, 0.2)
    model, data = still_scene([(BRICK, true)])
    picture = SimulatedCamera(CORNER).look([(model, data)])
    sure = register(views_of([picture], [CORNER]), Believed("a", BRICK, true, TURNS))
    spread = np.diag([1e-6] * 3 + [1e-4] * 3)
    unsure = replace(CORNER, covariance=tuple(map(tuple, spread.tolist())))
    seen = register(views_of([picture], [unsure]), Believed("a", BRICK, true, TURNS))
    more = seen.covariance - sure.covariance
    far = np.linalg.norm(CORNER.position - true[:3])
    assert np.trace(more[:3, :3]) == pytest.approx(3e-6 + 2 * 1e-4 * far**2, rel=0.02)


# ---------------------------------------------------------------- layouts

GOOD = {"name": "above", "position": [0, 0, 1], "look_at": [0, 0, 0]}


def layout(folder: Path, *cameras: object) -> Path:
    path = folder / "layout.json"
    head = {"format": "learn2assemble-layout", "version": 2, "cameras": list(cameras)}
    path.write_text(json.dumps(head))
    return path


def test_cameras_of_a_layout(tmp_path: Path) -> None:
    more = GOOD | {"name": "b", "resolution": [320, 240], "noise": {"growth": 0.002}, "rate": 5.0}
    site = read_site(layout(tmp_path, GOOD, more))
    assert [camera.name for camera in site.cameras] == ["above", "b"]
    assert site.cameras[1].resolution == (320, 240)
    assert site.cameras[1].noise == DepthNoise(growth=0.002)
    assert np.allclose(site.cameras[0].turn[:, 2], [0, 0, -1])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"resolution": [0, 480]}, "cameras[0].resolution"),
        ({"resolution": [10**6, 10**6]}, "pixels at most"),
        ({"noise": {"floor": -0.001}}, "cameras[0].noise.floor"),
        ({"noise": {"flor": 0.001}}, "did you mean 'floor'"),
        ({"noise": {"edges": 1.5}}, "cameras[0].noise.edges"),
        ({"position": [0, 0, float("nan")]}, "finite"),
        ({"position": [0, 0, 1e5]}, "cameras[0].position[2]"),
        ({"position": [0.3, 0.0, -1.0]}, "a place above the table"),
        ({"look_at": [0, 0, 1]}, "away from the camera"),
        ({"quaternion": [1, 0, 0, 0]}, "one of look_at and quaternion"),
        ({"look_at": None, "quaternion": [0, 0, 0, 0]}, "length 1"),
        ({"field_of_view": 0.0}, "cameras[0].field_of_view"),
        ({"range": [1.0, 0.5]}, "cameras[0].range"),
        ({"rate": 0.0}, "cameras[0].rate"),
        ({"frames": 0}, "cameras[0].frames"),
        ({"covariance": [[1.0]]}, "6 x 6"),
        ({"name": " "}, "cameras[0].name"),
    ],
)
def test_a_camera_that_is_none_is_refused_in_one_line(
    tmp_path: Path, change: dict, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        read_site(layout(tmp_path, GOOD | change))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_cameras_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cameras\[1\].name"):
        read_site(layout(tmp_path, GOOD, GOOD))


@pytest.mark.parametrize("seed", range(8))
def test_what_pictures_do_not_tell_is_taken_out_and_nothing_else(seed: int) -> None:
    """In units of the search, whatever those are: along directions of which they tell enough all of
    it stays, along the others nothing."""
    rng = np.random.default_rng(seed)
    sigma = np.array([0.004] * 3 + [0.05] * 3)
    axes = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    told = 10.0 ** np.array([5, 4, 3, 2, -1, -3])
    rows = axes / sigma[:, None]
    information, gradient = (rows * told) @ rows.T, rng.standard_normal(6)
    kept, pull = what_is_told(information, gradient, np.diag(sigma**-2.0))
    within = axes.T * sigma
    for k, much in enumerate(told):
        expected = much if much > ENOUGH**2 else 0.0
        assert within[k] @ kept @ within[k] == pytest.approx(expected, abs=1e-6, rel=1e-6)
        assert within[k] @ pull == pytest.approx(
            within[k] @ gradient if expected else 0.0, abs=1e-9
        )


# What statics adds to the reading of a block that stands alone.

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
