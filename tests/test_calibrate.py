"""Base, table and camera from touches, sightings and tags (``l2a calibrate``)."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from brick_data import BRICK, CORNER, TURNS, lying, off_by, shifted
from learn2assemble.acting.calibrate import calibrate
from learn2assemble.cell.site import read_site
from learn2assemble.errors import InputError
from learn2assemble.geometry.rotations import matrix_quaternion, quaternion_matrix, yaw_quaternion
from learn2assemble.sensing.calibration import (
    Sighting,
    Touch,
    calibrated,
    table_sightings,
)
from learn2assemble.sensing.camera import rotation
from learn2assemble.sensing.pictures import SimulatedCamera, still_scene
from learn2assemble.sensing.registration import Believed, register
from learn2assemble.sensing.residuals import views_of
from learn2assemble.sensing.search import find

BASE = np.array([0.0, -0.5, 0.0, *yaw_quaternion(1.57)])
OFF = np.array([0.004, -0.003, 0.002, 0.006, -0.008, 0.01])
"""By how much the base is elsewhere than the layout says."""
ASKEW = np.array([0.002, -0.0015, 0.0015, 0.01, -0.008, 0.012])
"""The same of the camera: 3 mm, 1 degree."""


def moved(pose: np.ndarray, by: np.ndarray) -> np.ndarray:
    turn = rotation(by[3:]) @ quaternion_matrix(pose[3:])
    return np.array([*(pose[:3] + by[:3]), *matrix_quaternion(turn)])


def in_base(base: np.ndarray, point: np.ndarray) -> np.ndarray:
    return quaternion_matrix(base[3:]).T @ (point - base[:3])


def touched(base: np.ndarray, rng: np.random.Generator, sigma: float) -> list[Touch]:
    """The table at eight places, and three marks on it."""
    found = []
    for _ in range(8):
        point = np.array([*rng.uniform(-0.3, 0.3, 2), 0.0])
        found.append(Touch(in_base(base, point) + rng.normal(0, sigma, 3), None, sigma))
    for x, y in ((0.2, 0.1), (-0.2, 0.1), (0.0, -0.2)):
        mark = np.array([x, y, 0.0])
        found.append(Touch(in_base(base, mark) + rng.normal(0, sigma, 3), mark, sigma))
    return found


def test_touches_tell_where_base_and_table_are_within_their_covariance() -> None:
    true, spread = moved(BASE, OFF), []
    for seed in range(40):
        readings = touched(true, np.random.default_rng(seed), 3e-4)
        found = calibrated(BASE, (), readings)
        assert found.told["base"] == (True,) * 6
        off = off_by(found.base, true)
        assert np.linalg.norm(off[:3]) < 0.003
        spread.append(off @ np.linalg.solve(found.base_covariance, off) / 6)
    assert 0.4 < np.mean(spread) < 2.0


def test_the_table_alone_tells_height_and_lean_and_nothing_else() -> None:
    readings = touched(moved(BASE, OFF), np.random.default_rng(0), 3e-4)[:8]
    found = calibrated(BASE, (), readings)
    assert found.told["base"] == (False, False, True, True, True, False)
    assert np.abs(off_by(found.base, BASE)[[0, 1, 5]]).max() < 1e-3


def test_one_touch_of_something_else_counts_little() -> None:
    true = moved(BASE, OFF)
    readings = touched(true, np.random.default_rng(1), 3e-4)
    good = calibrated(BASE, (), readings)
    bad = readings[4]
    readings[4] = bad._replace(tip=shifted(bad.tip, [0, 0, 0.02]))
    found = calibrated(BASE, (), readings)
    assert np.linalg.norm(off_by(found.base, good.base)[:3]) < 0.001
    assert found.worst[0] == 4
    assert found.worst[1] > 30


def test_blocks_that_the_arm_has_put_down_tell_where_the_camera_is() -> None:
    """Without tags: what the camera sees of them against where the arm let them go."""
    true = CORNER.moved(ASKEW[:3], rotation(ASKEW[3:]))
    camera, readings = SimulatedCamera(CORNER, ASKEW, seed=2), []
    assert np.allclose(camera.camera.pose, true.pose)
    places = [(-0.15, -0.1), (0.15, -0.1), (0.0, 0.12), (-0.15, 0.15), (0.15, 0.15), (0, -0.18)]
    for k, (x, y) in enumerate(places):
        put = lying(x, y, 0.5 * k)
        picture = camera.look([still_scene([(BRICK, put)])])
        views = views_of([picture], [CORNER])
        # It is seen two centimetres from where it is.
        (first,) = find(views, [Believed("a", BRICK, None, TURNS)], [])
        near = np.array([*first.pose[:3], *put[3:]])
        seen = register(views, Believed("a", BRICK, near, TURNS))
        assert seen.look == "seen"
        for arm in ([0.03, 0, 0.01], [-0.03, 0.01, 0], [0, 0, 0.0]):
            local = seen.pose[:3] + quaternion_matrix(seen.pose[3:]) @ arm - CORNER.position
            there = put[:3] + quaternion_matrix(put[3:]) @ arm
            readings.append(Sighting("corner", local @ CORNER.turn, None, in_base(BASE, there)))
        readings += table_sightings(picture, CORNER)[::8] if not k else []
    # The base is where it is, by its touches; the camera follows.
    readings += touched(BASE, np.random.default_rng(0), 1e-4)
    found = calibrated(BASE, (CORNER,), readings)
    after = found.cameras[0]
    before, now = (
        max(
            np.linalg.norm((true.turn @ p + true.position) - (one.turn @ p + one.position))
            for p in ([0.0, 0, 1.1], [0.15, 0.1, 1.0], [-0.15, 0.1, 1.2])
        )
        for one in (CORNER, after)
    )
    assert before > 0.008
    assert now < 0.0015
    off = off_by(np.array(after.pose), np.array(true.pose))
    assert off @ np.linalg.solve(np.array(after.covariance), off) < 60


# ---------------------------------------------------------------- files


def layout(folder: Path, **more: object) -> Path:
    camera = {
        "name": "corner",
        "position": list(CORNER.pose[:3]),
        "quaternion": list(CORNER.pose[3:]),
        "resolution": [1280, 960],
        "frames": 1,
    }
    root = {
        "format": "learn2assemble-layout",
        "version": 2,
        "base": {"position": [0.0, -0.5, 0.0], "yaw": 1.57},
        "cameras": [camera],
        "magazines": [{"kind": "1x4", "at": [0.0, -0.2]}],
    }
    path = folder / "cell.json"
    path.write_text(json.dumps(root | more))
    return path


def written(folder: Path, **more: object) -> Path:
    path = folder / "readings.json"
    path.write_text(json.dumps({"format": "learn2assemble-readings", "version": 1} | more))
    return path


def as_entries(readings: list[Touch]) -> list[dict]:
    return [
        {"tip": one.tip.tolist(), "sigma": one.sigma}
        | ({} if one.at is None else {"at": one.at.tolist()})
        for one in readings
    ]


def test_a_layout_is_put_right(tmp_path: Path) -> None:
    true = moved(BASE, OFF)
    path = layout(tmp_path)
    before = json.loads(path.read_text())
    touches = as_entries(touched(true, np.random.default_rng(0), 1e-4))
    made = calibrate(path, written(tmp_path, touches=touches))
    after = json.loads(path.read_text())
    assert after["magazines"] == before["magazines"]
    assert after["cameras"] == before["cameras"], "nothing was read of the camera"
    site = read_site(path)
    assert site.base is not None
    assert np.abs(np.array(site.base[:3]) - true[:3]).max() < 0.0006
    turn = quaternion_matrix(true[3:])
    assert site.base[3] == pytest.approx(math.atan2(turn[1, 0], turn[0, 0]), abs=0.002)
    assert site.lean == pytest.approx(tuple(turn[:2, 2]), abs=0.001)
    assert made.spread(1) == (math.inf, math.inf)
    # Again, from where it is now: nothing changes any more.
    again = calibrate(path, tmp_path / "readings.json", out=tmp_path / "other.json")
    assert again.moved["base"][0] < 0.005
    assert json.loads((tmp_path / "other.json").read_text())["magazines"] == before["magazines"]


def test_tags_in_a_picture_tell_where_the_camera_is(tmp_path: Path) -> None:
    pytest.importorskip("pupil_apriltags")
    from learn2assemble.sensing.tags import drawn

    path = layout(tmp_path)
    camera = read_site(path).cameras[0]
    held = SimulatedCamera(camera, ASKEW)
    places = {0: (-0.2, -0.15, 0.0), 1: (0.2, -0.1, 0.4), 2: (-0.15, 0.2, -0.3), 5: (0.2, 0.2, 1.0)}
    tags = [(n, lying(x, y, yaw, 0.0), 0.06) for n, (x, y, yaw) in places.items()]
    picture = drawn(held.look([still_scene([])]), held.camera, tags)
    Image.fromarray(picture.grey).save(tmp_path / "seen.png")
    told = [{"number": n, "size": 0.06, "at": list(at)} for n, at in places.items()]
    shot = [{"camera": "corner", "file": "seen.png"}]
    made = calibrate(path, written(tmp_path, tags=told, pictures=shot))
    (after,) = read_site(path).cameras
    assert made.found.told == {"base": (False,) * 6, "corner": (True,) * 6}
    off = off_by(np.array(after.pose), np.array(held.camera.pose))
    assert np.linalg.norm(off[:3]) < 0.003
    assert np.degrees(np.linalg.norm(off[3:])) < 0.2
    assert after.covariance is not None
    assert read_site(path).base == (0.0, -0.5, 0.0, 1.57)


def test_joints_are_the_tip_of_the_tool(tmp_path: Path) -> None:
    from learn2assemble.kinematics.chain import forward, get_chain
    from learn2assemble.robot.arm import get_arm

    path = layout(tmp_path)
    arm = get_arm("ur5e", "suction", (0.0, 0.0, 0.0, 0.0))
    tip = forward(get_chain(arm), arm.home)[0]
    at = (BASE[:3] + quaternion_matrix(BASE[3:]) @ tip + [0.001, 0.002, 0.003]).tolist()
    touches = [{"joints": arm.home.tolist(), "at": at, "sigma": 1e-5}]
    calibrate(path, written(tmp_path, touches=touches), arm="ur5e", tool="suction")
    base = read_site(path).base
    assert base is not None
    here = np.array(base[:3]) + quaternion_matrix(yaw_quaternion(base[3])) @ tip
    assert np.abs(here - at).max() < 0.0035


TIP = [{"tip": [0.1, 0.2, 0.0]}]


@pytest.mark.parametrize(
    ("more", "arguments", "words"),
    [
        ({}, {}, "no readings"),
        ({"touches": [{}]}, {}, "touches[0]"),
        (
            {"touches": [{"tip": [0, 0, 0], "joints": [0.0]}]},
            {"arm": "ur5e"},
            "one of tip and joints",
        ),
        ({"touches": [{"joints": [0.0]}]}, {}, "the name of the arm"),
        ({"touches": [{"joints": [0.0]}]}, {"arm": "ur5e"}, "6 angles of ur5e"),
        ({"touches": [{"joints": [0.0]}]}, {"arm": "ur5"}, "did you mean 'ur5e'"),
        ({"touches": [{"tip": [0, 0, 1e9]}]}, {}, "touches[0].tip[2]"),
        ({"touches": [{"tip": [0, 0, 0], "sigma": 0}]}, {}, "touches[0].sigma"),
        ({"points": [{"camera": "korner", "seen": [0, 0, 1]}]}, {}, "did you mean 'corner'"),
        ({"pictures": [{"camera": "corner", "file": "no.png"}]}, {}, "no.png"),
        ({"pictures": [{"camera": "corner", "file": "cell.json"}]}, {}, "a picture"),
        ({"tags": [{"number": 1, "size": 0, "at": [0, 0, 0]}]}, {}, "tags[0].size"),
        ({"touches": TIP * 3, "familie": "x"}, {}, "did you mean 'family'"),
        ({"touches": TIP}, {"out": "/no/such/folder/cell.json"}, "layout"),
    ],
)
def test_what_cannot_be_read_changes_no_file(
    tmp_path: Path, more: dict, arguments: dict, words: str
) -> None:
    path = layout(tmp_path)
    before = path.read_bytes()
    with pytest.raises(InputError) as caught:
        calibrate(path, written(tmp_path, **more), **arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 2


def test_the_command_says_what_was_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from learn2assemble.cli import main

    path = layout(tmp_path)
    touches = as_entries(touched(moved(BASE, OFF), np.random.default_rng(0), 1e-4))
    told = written(tmp_path, touches=touches)
    assert main(["calibrate", str(path), "--readings", str(told)]) == 0
    said = capsys.readouterr().out
    assert "6 of 6" in said
    assert "0 of 6" in said
    assert read_site(path).lean != (0.0, 0.0)


def test_a_layout_without_a_base_is_refused(tmp_path: Path) -> None:
    path = layout(tmp_path)
    root = json.loads(path.read_text())
    del root["base"]
    path.write_text(json.dumps(root))
    with pytest.raises(InputError, match="base: got 'none'"):
        calibrate(path, written(tmp_path, touches=TIP))


def test_readings_of_no_camera_are_refused() -> None:
    with pytest.raises(InputError, match="one of none"):
        calibrated(BASE, (), [Sighting("corner", np.array([0.0, 0, 1]))])
    with pytest.raises(InputError, match="none"):
        calibrated(BASE, (), [])
