"""The video of a build: what the small renderer sees, the words below it, and the file."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arm_record import arm_plan, arm_record
from learn2assemble.cli import main
from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.kinematics.shape import box
from learn2assemble.motion.files import write_record
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.reports import ArmReport
from learn2assemble.viewer import video
from learn2assemble.viewer.playback import Playback
from learn2assemble.viewer.renderer import (
    GROUND,
    LIT,
    SAMPLES,
    BodyStates,
    Buffers,
    Camera,
    Light,
    Triangles,
    blend_sheet,
    fill,
    render,
)
from learn2assemble.viewer.video import (
    FRAMES_PER_SECOND,
    HEIGHT,
    WIDTH,
    Frames,
    moments,
    write_video,
)

COUNT = 3
SIZE = 64


@pytest.fixture(scope="module")
def film() -> Frames:
    return Frames(arm_plan(COUNT), (arm_record("panda", COUNT),))


# ---------------------------------------------------------------- what is seen


_CORNER = st.tuples(st.floats(-5, SIZE + 5), st.floats(-5, SIZE + 5), st.floats(0.1, 1))


@given(st.lists(st.tuples(_CORNER, _CORNER, _CORNER), min_size=1, max_size=5))
@settings(max_examples=60, deadline=None)
def test_every_sample_sees_the_nearest_triangle(corners: list[Any]) -> None:
    screen = np.array(corners, np.float32).reshape(-1, 3)
    faces = np.arange(len(screen), dtype=np.int32).reshape(-1, 3)
    depth, seen = np.zeros((SIZE, SIZE), np.float32), np.full((SIZE, SIZE), -1, np.int32)
    fill(screen, faces, np.ones(len(faces), bool), -1, depth, seen)
    y, x = (grid + 0.5 for grid in np.mgrid[:SIZE, :SIZE])
    near, margin = np.zeros((SIZE, SIZE)), np.full((SIZE, SIZE), np.inf)
    for a, b, c in screen.astype(float).reshape(-1, 3, 3):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area > -1e-5:
            continue
        u = ((c[0] - b[0]) * (y - b[1]) - (c[1] - b[1]) * (x - b[0])) / area
        v = ((a[0] - c[0]) * (y - c[1]) - (a[1] - c[1]) * (x - c[0])) / area
        inside = np.minimum(np.minimum(u, v), 1 - u - v)
        here = np.where(inside >= 0, u * a[2] + v * b[2] + (1 - u - v) * c[2], 0)
        margin = np.minimum(margin, np.abs(inside))
        margin = np.where(inside >= 0, np.minimum(margin, np.abs(near - here) + 1e-9), margin)
        near = np.maximum(near, here)
    sure = margin > 1e-3  # not on an edge, and not where two triangles cross
    np.testing.assert_array_equal(seen[sure] >= 0, near[sure] > 0)
    np.testing.assert_allclose(depth[sure], near[sure], atol=1e-3)


def still_life(kinds: list[int], boxes: list[tuple[np.ndarray, np.ndarray]]) -> Triangles:
    rows = []
    for k, (kind, (half, centre)) in enumerate(zip(kinds, boxes, strict=True)):
        mesh = box(np.array(half, float))
        rows.append(
            (
                mesh.vertices + centre,
                mesh.normals,
                np.full(len(mesh.vertices), k),
                mesh.faces + 24 * k,
                np.full(len(mesh.faces), kind),
            )
        )
    vertices, normals, body, faces, kind = (np.concatenate(c) for c in zip(*rows, strict=True))
    return Triangles(
        vertices.astype(np.float32),
        normals.astype(np.float32),
        np.zeros((len(vertices), 2), np.float32),
        body.astype(np.int32),
        faces.astype(np.int32),
        kind.astype(np.uint8),
    )


def test_a_box_hides_what_is_behind_and_casts_a_shadow() -> None:
    """From straight above, the sun from the left: the shadow lies on the right."""
    ground, cube = ((1, 1, 0.1), (0, 0, -0.1)), ((0.1, 0.1, 0.1), (0, 0, 0.1))
    scene = still_life([GROUND, LIT], [ground, cube])
    axes = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    camera = Camera(np.array([0, 0, 10.0]), axes, 500.0, np.array([50.0, 50.0]))
    sun = np.array([-1.0, 0, 1.0]) / np.sqrt(2)
    light = Light(np.stack([[0, 1, 0], np.cross(sun, [0, 1, 0]), sun]), np.array([-2, -2.0]), 4.0)
    colour = np.array([[200, 200, 200], [250, 0, 0]], np.float32)
    stand, turn = np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
    sky, rim = np.array([0, 0, 255], np.float32), np.zeros(3, np.float32)
    buffers = Buffers(scene, 120, 100)

    def picture(cube_shown: bool) -> np.ndarray:
        shown = np.array([True, cube_shown])
        bodies = BodyStates(stand, turn, shown, colour)
        return render(scene, buffers, camera, light, bodies, sky, rim).astype(int)

    with_cube, without = picture(True), picture(False)
    assert (with_cube[50, 110] == [0, 0, 255]).all(), "beyond the ground is sky"
    assert with_cube[50, 50, 0] > 150
    assert with_cube[50, 50, 1] == 0, "the cube is red from above"
    assert with_cube[50, 60, 0] < without[50, 60, 0] - 30, "shadow on the right"
    for y, x in ((50, 40), (60, 50), (40, 50)):
        np.testing.assert_array_equal(with_cube[y, x], without[y, x])
    # 10 cm high, sun at 45 degrees: the shadow of the 20 cm cube ends 20 cm to its right.
    dark = np.flatnonzero(with_cube[50, :, 0] < without[50, :, 0] - 15)
    dark = dark[dark > 55]
    assert (dark.min(), dark.max()) == (pytest.approx(55, abs=1), pytest.approx(65, abs=1))


def test_a_sheet_tints_only_what_lies_behind_it() -> None:
    depth = np.zeros((20 * SAMPLES, 20 * SAMPLES), np.float32)
    depth[:, : 10 * SAMPLES] = 2.0
    image = np.full((20, 20, 3), 100, np.uint8)
    corners = np.array([[0, 0, 1], [80, 0, 1], [0, 80, 1]], np.float32)
    blend_sheet(corners, np.array([0, 200, 100], np.float32), 0.5, depth, image)
    assert (image[5, :10] == 100).all()
    np.testing.assert_allclose(image[5, 10:], np.tile([50, 150, 100], (10, 1)), atol=1)


# ---------------------------------------------------------------- frames and file


def test_frames_show_the_build(film: Frames) -> None:
    first, last = film.frame(0.0).copy(), film.frame(film.playback.duration).copy()
    assert first.shape == last.shape == (HEIGHT, WIDTH, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, film.frame(0.0))
    segment = film.playback.segments[0]
    cross = next(stage for stage in segment.step.stages if stage.name == "cross")
    carried = film.frame((cross.start + cross.end) / 2).copy()
    blue = [
        ((picture[..., 2] > 180) & (picture[..., 0] < 140)).sum()
        for picture in (first, carried, last)
    ]
    assert blue[1] > 15 + max(blue[0], blue[2]), "the block of the step is blue"
    for a, b in ((first, carried), (carried, last), (first, last)):
        assert (np.abs(a.astype(int) - b).max(-1) > 40).mean() > 0.005
    white = [(picture[:-92].min(-1) > 200).mean() for picture in (first, carried, last)]
    assert min(white) > 0.01, "the arm is always there"


def test_the_words_below_follow_the_arm(film: Frames) -> None:
    lost = film.playback.segments[1]
    said = {film.doing(clock) for clock in np.linspace(lost.start + 0.01, lost.end, 60)}
    assert {"The arm goes down to b2.", "The arm goes up without a block."} <= said
    assert film.doing(0.0) == "The arm waits."
    assert film.doing(film.playback.duration) == "The build is over."


def test_the_words_are_in_the_picture(film: Frames) -> None:
    """Ink where the lines of words stand, and the bar of attempts filled up to the clock."""
    half = film.playback.duration / 2
    picture = film.frame(half).astype(int)
    for low, high in ((20, 48), (480, 510), (516, 536)):
        assert (picture[low:high].max(-1) < 110).sum() > 100
    bar = picture[468, 24:-24]
    filled = (np.abs(bar - [11, 114, 133]).max(-1) < 20) | (
        np.abs(bar - [163, 38, 28]).max(-1) < 20
    )
    assert filled[: len(bar) // 2 - 2].mean() > 0.8
    assert not filled[len(bar) // 2 + 2 :].any()


@pytest.mark.parametrize("view", [[0.0, 0.8], [math.pi, -0.8]])
@pytest.mark.parametrize("drawn", [("front",), ("back", "front"), None])
def test_a_drawing_is_seen_from_its_front_or_it_is_said(
    drawn: tuple[str, ...] | None, view: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of an arm that stands before it; whether it hides the front is another test's."""
    monkeypatch.setattr(Playback, "side", property(lambda _: math.pi / 2))
    monkeypatch.setattr(video, "first_view", lambda *_: view)
    plan = arm_plan(COUNT)
    plan = replace(plan, design=replace(plan.design, drawn=drawn))
    made = Frames(plan, (arm_record("panda", COUNT),))
    front = drawn == ("front",) and view[0] == 0
    assert (made.camera.position[1] < 0) == front
    assert made.behind == (drawn == ("front",) and not front)
    words = made.frame(0.0)[54:72, WIDTH - 200 :]
    assert ((words.max(-1) < 160).sum() > 100) == made.behind


def test_moments_play_the_whole_build_and_hold_its_end() -> None:
    clocks = moments(10.0, 4.0)
    assert clocks[0] == 0
    np.testing.assert_allclose(np.diff(clocks[:60]), 4 / FRAMES_PER_SECOND)
    assert clocks[-1] == clocks[-FRAMES_PER_SECOND] == 10.0
    assert (np.diff(clocks) >= 0).all()


def test_the_video_opens_and_has_its_length_and_size(
    film: Frames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    av = pytest.importorskip("av")
    monkeypatch.setattr("learn2assemble.viewer.video.SPEED", 20.0)
    plan, record = arm_plan(COUNT), arm_record("panda", COUNT)
    for name in ("a.mp4", "b.mp4"):
        write_video(plan, (record,), tmp_path / name)
    clocks = moments(film.playback.duration, 20)
    with av.open(str(tmp_path / "a.mp4")) as file:
        stream = file.streams.video[0]
        assert (stream.codec_context.name, stream.average_rate) == ("h264", FRAMES_PER_SECOND)
        assert (stream.width, stream.height) == (WIDTH, HEIGHT)
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        length = float(stream.duration * stream.time_base)
    with av.open(str(tmp_path / "b.mp4")) as file:
        again = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    # The encoder's own threads may change a grey level here and there.
    assert max(np.abs(a.astype(int) - b).mean() for a, b in zip(frames, again, strict=True)) < 1
    assert len(frames) == len(clocks)
    assert length == pytest.approx(len(clocks) / FRAMES_PER_SECOND, abs=0.05)
    for k in (0, len(frames) // 2, len(frames) - 1):
        error = np.abs(frames[k].astype(float) - film.frame(clocks[k])).mean()
        assert error < 6, "the file shows what was drawn"
    assert np.abs(frames[0].astype(float) - frames[-1]).max() > 80


def test_without_the_extra_the_error_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtraError, match=r"learn2assemble\[video\]"):
        write_video(arm_plan(COUNT), (arm_record("panda", COUNT),), tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_a_path_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("av")
    with pytest.raises(InputError, match="can be written"):
        write_video(arm_plan(COUNT), (arm_record("panda", COUNT),), tmp_path / "no" / "a.mp4")


# ---------------------------------------------------------------- all files of a build


def test_the_files_of_a_build_and_an_unsound_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Path] = []
    monkeypatch.setattr(
        "learn2assemble.viewer.video.write_video", lambda plan, record, path, _: drawn.append(path)
    )
    record = arm_record("panda", COUNT)
    plan = replace(arm_plan(COUNT), records=(record,))
    files = plan.save(tmp_path, video=True, page=False)
    assert {path.name for path in files.values()} >= {
        "plan.json",
        "assembly.json",
        "trajectory.json",
        "trajectory.csv",
        "build.mp4",
    }
    assert drawn == [tmp_path / "build.mp4"]
    slow = replace(record, arm=replace(record.arm, velocity=record.arm.velocity / 5))
    report = ArmReport("panda", 0.06, 2, (), 1.0)
    replace(plan, records=(slow,), arm=report).save(tmp_path, video=True, page=False)
    told = Plan.load(tmp_path).arm
    assert told is not None
    assert "rad/s, limit" in str(told.motion_fault)
    assert len(drawn) == 2
    still = replace(plan, records=(replace(record, steps=()),))
    assert "video" not in still.save(tmp_path, video=True, page=False)


def test_view_shows_the_arm_of_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learn2assemble.viewer.server.serve", lambda *_: "")
    arm_plan(COUNT).save(tmp_path, page=False)
    page = tmp_path / "view.html"
    assert main(["view", str(tmp_path), "--no-browser"]) == 0
    assert '<body class="movable assembly">' in page.read_text(encoding="utf-8")
    page.unlink()
    write_record(arm_record("panda", COUNT), tmp_path / "trajectory.json")
    assert main(["view", str(tmp_path), "--no-browser"]) == 0
    assert '<body class="movable assembly with-arm">' in page.read_text(encoding="utf-8")
