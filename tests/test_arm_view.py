"""The page with the moving arm: what it shows is what the record says."""

from __future__ import annotations

import base64
import html
import json
import math
import re
import tempfile
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from arm_record import arm_plan, arm_record
from headless import SPATIAL, browse, find_browser, pixels, shoot
from learn2assemble.cli import main
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.geometry.rotations import quaternion_matrix, yaw_matrix
from learn2assemble.kinematics import shape as shapes
from learn2assemble.kinematics.approach import reached_area
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.kinematics.inverse import solve
from learn2assemble.kinematics.shape import Mesh, arm_shape, box, capsule, shaded
from learn2assemble.motion.record import BuildRecord, Stage
from learn2assemble.planning.plan import Plan
from learn2assemble.robot.arm import arm_model, arms_spec, get_arm
from learn2assemble.robot.moves import Outcome
from learn2assemble.viewer import words as arm_words
from learn2assemble.viewer.page import write_plan_page
from learn2assemble.viewer.playback import PAUSE, Playback, split

EDGE = 0.05
COUNT = 6


def write_page(plan: Plan, path: Path, record: BuildRecord | None) -> None:
    write_plan_page(replace(plan, records=() if record is None else (record,)), path)


def render_page(plan: Plan, record: BuildRecord | None = None) -> str:
    with tempfile.TemporaryDirectory() as folder:
        write_page(plan, Path(folder) / "view.html", record)
        return (Path(folder) / "view.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def record() -> BuildRecord:
    return arm_record("panda", COUNT)


@pytest.fixture(scope="module")
def playback(record: BuildRecord) -> Playback:
    return Playback((record,), arm_plan(COUNT))


def stepped(record: BuildRecord, k: int, **fields: Any) -> BuildRecord:
    steps = list(record.steps)
    steps[k] = replace(steps[k], **fields)
    return replace(record, steps=tuple(steps))


# ---------------------------------------------------------------- the shape of an arm


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def test_simple_solids_have_their_volume_and_normals_point_out() -> None:
    for mesh, wanted in (
        (box(np.array([1, 2, 3.0])), 48.0),
        (capsule(1, 2, rounded=False), 4 * np.pi),
        (capsule(1, 2), 4 * np.pi + 4 / 3 * np.pi),
        (capsule(1, 0), 4 / 3 * np.pi),
    ):
        assert volume(mesh) == pytest.approx(wanted, rel=0.035)
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)
        assert ((mesh.normals * mesh.vertices).sum(1) > 0).all()


def test_sharp_edges_stay_sharp_and_round_ones_round() -> None:
    assert len(box(np.ones(3)).vertices) == 24, "three normals at every corner of a box"
    ball = capsule(1.0, 0.0)
    np.testing.assert_allclose(ball.normals, ball.vertices, atol=0.09)
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.0, 1, 0]])
    mesh = shaded(flat, np.array([[0, 1, 2], [0, 4, 3], [1, 1, 2]]))
    assert len(mesh.vertices) == 4, "equal corners are merged"
    assert len(mesh.faces) == 2, "faces without area are left out"


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_parts_stand_where_the_model_has_them(name: str) -> None:
    arm = get_arm(name)
    shape, model = arm_shape(arm), arm_model(arm, pictures=True)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for width in (0.0, 0.06):
        q = rng.uniform(arm.lower, arm.upper)
        for joint, value in zip(arm.joints, q, strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = value
        for joint in arm.gripper.joints:
            data.qpos[model.joint(joint).qposadr[0]] = width / 2
        mujoco.mj_kinematics(model, data)
        position, rotation = shape.frames(q, width)
        for part in shape.parts:
            geom = model.geom(part.name).id
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            points = model.mesh_vert[first : first + count].astype(float)
            points = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            drawn = part.mesh.vertices
            if part.frame >= 0:
                drawn = drawn @ rotation[part.frame].T + position[part.frame]
            for end in (np.min, np.max):
                np.testing.assert_allclose(end(drawn, 0), end(points, 0), atol=3e-6)


def test_arms_in_one_model_keep_their_own_meshes() -> None:
    # Both have a mesh of a black finger; MuJoCo tells files of a model apart by their names.
    arms = [get_arm(name) for name in ("panda", "ur5e")]
    both = arms_spec(arms, pictures=True).compile()
    alone = [arm_model(arm, pictures=True) for arm in arms]
    parts = [model.mesh_vert for model in alone]
    np.testing.assert_array_equal(both.mesh_vert, np.concatenate(parts))


def test_an_arm_without_pictures_is_drawn_by_its_solids(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shapes, "arm_model", lambda arm, pictures: arm_model(arm))
    shape = arm_shape.__wrapped__(get_arm("panda"))
    assert len(shape.parts) > 20
    assert {part.frame for part in shape.parts} == set(range(-1, 9))
    assert all(volume(part.mesh) > 0 for part in shape.parts)


# ---------------------------------------------------------------- playing it


def test_the_arm_follows_the_samples(record: BuildRecord, playback: Playback) -> None:
    samples, _ = record.joined()
    for segment in playback.segments:
        step = segment.step.samples
        for i in range(0, len(step.time), 37):
            joints, width = playback.arm_at(step.time[i] + segment.delay)
            np.testing.assert_allclose(joints, step.joints[i], atol=1e-9)
            assert width == pytest.approx(step.width[i])
    half = (samples.joints[10] + samples.joints[11]) / 2
    np.testing.assert_allclose(playback.arm_at(10.5 / record.rate)[0], half, atol=1e-12)


def test_steps_without_a_motion_can_be_read(playback: Playback) -> None:
    still = [s for s in playback.segments if s.step.outcome == Outcome.UNREACHABLE]
    assert len(still) == 1
    assert still[0].end - still[0].start == PAUSE
    before, during = playback.arm_at(still[0].start), playback.arm_at(still[0].end - 0.1)
    np.testing.assert_array_equal(before[0], during[0])
    assert playback.duration == pytest.approx(playback.record.spans()[-1][1] + PAUSE)


def test_a_held_block_keeps_its_place_in_the_hand(playback: Playback) -> None:
    for segment in playback.segments:
        for glide in segment.glides:
            if glide.grip is None:
                continue
            inside = []
            for clock in np.linspace(glide.grip, glide.release - 1e-6, 7):
                tool, rotation = playback.arms[0].shape.tool(playback.arm_at(clock)[0])
                cells, turns = playback.cells_at(clock)
                inside.append(
                    [
                        *(rotation.T @ (cells[glide.cell] - tool)),
                        *(rotation.T @ quaternion_matrix(turns[glide.cell])).ravel(),
                    ]
                )
            np.testing.assert_allclose(inside, np.tile(inside[0], (7, 1)), atol=1e-9)
            assert np.linalg.norm(inside[0][:3]) < 0.02, "and that place is between the fingers"


def test_cells_begin_and_end_where_the_record_says(playback: Playback) -> None:
    for segment in playback.segments:
        for clock, wanted in (
            (segment.start + 1e-9, segment.step.before),
            (segment.end, segment.step.after),
        ):
            position, quaternion = playback.cells_at(clock)
            where, turned = split(wanted)
            np.testing.assert_allclose(position, where, atol=1e-6)
            np.testing.assert_allclose(abs((quaternion * turned).sum(1)), 1, atol=1e-9)


def test_nothing_jumps_but_what_falls(playback: Playback) -> None:
    clocks = np.arange(0, playback.duration, 0.02)
    places = np.array([playback.cells_at(clock)[0] for clock in clocks])
    speed = np.linalg.norm(np.diff(places, axis=0), axis=-1).max(1) / 0.02
    falling = np.zeros(len(speed), bool)
    for segment in playback.segments:
        for glide in segment.glides:
            if glide.falls:
                falling |= (clocks[1:] > glide.release) & (clocks[:-1] < glide.end)
    assert speed[~falling].max() < 2.0
    assert falling.any()
    assert speed[falling].max() > speed[~falling].max()


def test_an_arm_that_never_moves_stands_at_home() -> None:
    record = arm_record("panda", COUNT)
    still = next(step for step in record.steps if step.outcome == Outcome.UNREACHABLE)
    alone = replace(record, steps=(replace(still, number=1),))
    playback = Playback((alone,), arm_plan(COUNT))
    np.testing.assert_array_equal(playback.arm_at(1.0)[0], get_arm("panda").home)
    assert playback.duration == PAUSE
    assert "with-arm" in render_page(arm_plan(COUNT), alone)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: replace(r, objects=r.objects[:-1]), "the 6 blocks of the plan"),
        (lambda r: stepped(r, 0, plan_step=9), "1 to 5"),
        (lambda r: replace(r, arm=replace(r.arm, joints=("a", "b"))), "those of arm panda"),
    ],
)
def test_a_record_that_does_not_fit_is_refused(
    record: BuildRecord, change: Any, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        render_page(arm_plan(COUNT), change(record))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_arm_is_named(record: BuildRecord) -> None:
    with pytest.raises(UnknownNameError, match="panda"):
        render_page(arm_plan(COUNT), replace(record, arm=replace(record.arm, name="pander")))


# ---------------------------------------------------------------- words


def test_words_do_not_say_that_an_empty_hand_carries(record: BuildRecord) -> None:
    lost = next(s for s in record.steps if s.outcome == Outcome.GRASP_LOST)
    said = [arm_words.stage_words(lost, stage, "block 2") for stage in lost.stages]
    assert said[0] == "moves to above block 2"
    assert "goes up without a block" in said
    assert "lifts block 2" not in said
    good = record.steps[0]
    said = [arm_words.stage_words(good, stage, "block 1") for stage in good.stages]
    assert {"lifts block 1", "carries block 1 across", "lowers block 1 into its place"} <= {*said}


def test_every_stage_and_outcome_has_words(record: BuildRecord) -> None:
    for name in arm_words.STAGE_WORDS:
        step = replace(record.steps[0], stages=(Stage(name, 0.0, 1.0),))
        assert arm_words.stage_words(step, step.stages[0], "block 1")
    assert set(arm_words.OUTCOME_WORDS) == set(Outcome)


# ---------------------------------------------------------------- the page


def page_data(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert found
    return json.loads(found[1])


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    kind = {1: np.uint8, 2: np.dtype("<u2")}[packed["bytes"]]
    raw = np.frombuffer(base64.b64decode(packed["data"]), kind).reshape(-1, len(packed["low"]))
    return np.array(packed["low"]) + raw * np.array(packed["scale"])


def test_the_page_is_small_and_needs_nothing(tmp_path: Path) -> None:
    for name, count in (("panda", 20), ("ur5e", 12)):
        write_page(arm_plan(count), tmp_path / "view.html", arm_record(name, count))
        assert 500_000 < (tmp_path / "view.html").stat().st_size < 3_000_000
    text = (tmp_path / "view.html").read_text(encoding="utf-8")
    names = {"http://www.w3.org/1999/xhtml", "http://www.w3.org/2000/svg"}
    assert set(re.findall(r"https?://[^\s\"'`<>]+", text)) <= names
    assert not re.search(r"@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon", text)
    policy = re.search(r'Security-Policy" content="([^"]*)"', text)
    assert policy
    assert "default-src 'none'" in policy[1]
    assert policy[1].count("sha256-") == 6


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_what_an_arm_reaches_on_the_table(name: str) -> None:
    arm = get_arm(name, "suction", (0.3, -0.4, 0.0, 1.0))
    base, rotation = arm.base_position[:2], forward(get_chain(arm), arm.home)[1]
    corners = np.concatenate(reached_area(arm))
    away = np.linalg.norm(corners - base, axis=1)
    assert 0.5 < away.max() < 1.0
    assert away.min() < 0.3
    for corner in corners[away > 0.5][::9]:
        found = [
            solve(arm, np.array([*(base + share * (corner - base)), 0.05]), turn).ok
            for share in (0.98, 1.15)
            for turn in (yaw_matrix(k * math.pi / 4) @ rotation for k in range(8))
        ]
        assert any(found[:8])
        assert not any(found[8:])


@pytest.mark.browser
def test_an_arm_stands_in_the_page_of_what_it_reaches(tmp_path: Path) -> None:
    folder, design = tmp_path / "out", tmp_path / "wall.npy"
    np.save(design, np.ones((6, 1, 2), bool))
    assert main(["reach", str(design), "--arm", "ur5e", "--out", str(folder)]) == 0
    data = page_data((folder / "view.html").read_text(encoding="utf-8"))
    assert data["standing"]["areas"]
    (robot,) = data["standing"]["robots"]
    # It stands behind the wall, and beside it in the picture.
    assert (data["view"][1], robot["joints"][0]["offset"][1] < 0) == (-0.8, True)
    shots, log = shoot(find_browser(), folder, ("",), (1000, 700), *SPATIAL)
    assert "CONSOLE" not in log
    assert (shots[0][150:450, :560, :3] < 0.25).all(-1).sum() > 300  # Its joints are black.


def test_the_page_without_a_record_knows_no_arm() -> None:
    text = render_page(arm_plan(COUNT))
    assert "createArm(data, tools)" not in text
    assert "arm" not in page_data(text)
    assert 'id="doing"' not in text
    assert 'step="1" aria-label="Step"' in text
    assert 'data-side="0">Front</button>' in text
    empty = replace(arm_record("panda", COUNT), steps=())
    assert render_page(arm_plan(COUNT), empty) == text, "nothing was tried, nothing is shown"


def test_numbers_in_the_page_are_those_of_the_record(record: BuildRecord) -> None:
    data = page_data(render_page(arm_plan(COUNT), record))["arm"]
    samples, _ = record.joined()
    got = unpacked(data["robots"][0]["samples"])
    np.testing.assert_allclose(got[:, :-1], samples.joints, atol=1e-4)
    np.testing.assert_allclose(got[:, -1], samples.width, atol=1e-6)
    for part, wanted in zip(
        data["robots"][0]["parts"], arm_shape(get_arm("panda")).parts, strict=True
    ):
        np.testing.assert_allclose(unpacked(part["vertices"]), wanted.mesh.vertices, atol=1e-5)
        np.testing.assert_allclose(unpacked(part["normals"]), wanted.mesh.normals, atol=5e-3)
        faces = np.frombuffer(base64.b64decode(part["faces"]), "<u2").reshape(-1, 3)
        np.testing.assert_array_equal(faces, wanted.mesh.faces)
    assert [s["outcome"] for s in data["segments"]] == [s.outcome.label for s in record.steps]


def test_the_page_tells_the_outcome_of_every_step(record: BuildRecord) -> None:
    text = html.unescape(render_page(arm_plan(COUNT), record))
    assert text.count('<tr data-segment="') == len(record.steps)
    for step in record.steps:
        assert f">{step.outcome.label}</td>" in text
        assert arm_words.sentence(step.detail) in text
    assert text.count('class="tag">planned anew') == 3
    assert "5 of 8 attempts reached" in text
    assert len(re.findall(r'<rect class="failed"', text)) == 3


def test_a_sentence_does_not_change_the_name_of_a_block() -> None:
    assert arm_words.sentence("b24 touches b21", ("b21", "b24")) == "b24 touches b21."
    assert arm_words.sentence("nothing is met", ("b21", "b24")) == "Nothing is met."
    assert arm_words.sentence(" ") == ""


def test_the_page_is_the_same_every_time(record: BuildRecord) -> None:
    assert render_page(arm_plan(COUNT), record) == render_page(arm_plan(COUNT), record)


@pytest.mark.parametrize("evil", ["</script><script>alert(1)</script>", "<img src=x onerror=a()>"])
def test_text_from_a_record_never_becomes_markup(record: BuildRecord, evil: str) -> None:
    bad = stepped(replace(record, simulated_by=evil), 1, detail=evil)
    clean, text = render_page(arm_plan(COUNT), record), render_page(arm_plan(COUNT), bad)
    assert text.count("<script") == clean.count("<script")
    assert "<img" not in text
    assert html.escape(evil) in text


# ---------------------------------------------------------------- in a browser


HARNESS = """
const data = JSON.parse(document.getElementById("data").textContent), found = [], cells = [];
const nothing = { color: { set() {} } };
const tools = {
  coloured: (material) => material, colours: () => ({}),
  cube() {
    const group = new THREE.Group();
    cells.push(group);
    return { group, material: nothing, sides: new THREE.BoxGeometry(1, 1, 1) };
  },
};
const arm = createArm(data, tools), clock = armClock(data);
for (const time of TIMES) {
  arm.update(time);
  found.push({ said: clock.at(time), cells: cells.map(({ position: p, quaternion: q }) =>
    [p.x, p.y, p.z, q.w, q.x, q.y, q.z]) });
}
document.getElementById("out").textContent = JSON.stringify(found);
"""


@pytest.mark.browser
@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_browser_computes_the_same_places(browser: str, tmp_path: Path, name: str) -> None:
    """The chain of the arm in JavaScript against the compiled one, through the held blocks."""
    plan, record = arm_plan(COUNT), arm_record(name, COUNT)
    playback = Playback((record,), plan)
    times = np.linspace(0, playback.duration, 120).round(3)
    assets = resources.files("learn2assemble.viewer") / "assets"
    scripts = [
        (assets / n).read_text(encoding="utf-8") for n in ("three.bundle.js", "view.js", "arm.js")
    ]
    scripts.append(f"const TIMES = {json.dumps(times.tolist())};{HARNESS}")
    data = json.dumps(page_data(render_page(plan, record)))
    (tmp_path / "test.html").write_text(
        f'<!doctype html><pre id="out"></pre><script type="application/json" id="data">{data}'
        "</script>" + "".join(f"<script>{script}</script>" for script in scripts),
        encoding="utf-8",
    )
    dom, log = browse(browser, tmp_path / "run", (tmp_path / "test.html").as_uri(), "--dump-dom")
    out = re.search(r'<pre id="out">(.*?)</pre>', dom, flags=re.S)
    assert out, log
    assert out[1], log
    held = 0
    for time, got in zip(times, json.loads(html.unescape(out[1])), strict=True):
        places = np.array(got["cells"])
        position, quaternion = playback.cells_at(time)
        np.testing.assert_allclose(places[:, :3], position, atol=3e-4)
        np.testing.assert_allclose(abs((places[:, 3:] * quaternion).sum(1)), 1, atol=1e-5)
        held += np.any(position[:, 2] > 0.06)
        segment = playback.segment_at(time)
        if 0 < time < playback.duration:
            assert got["said"]["segment"] == segment.step.number - 1
            assert segment.step.outcome.label in got["said"]["outcome"]
    assert held > 20, "blocks were in the air"


@pytest.mark.browser
def test_the_arm_moves_in_the_3d_view(
    browser: str, tmp_path: Path, record: BuildRecord, playback: Playback
) -> None:
    write_page(arm_plan(COUNT), tmp_path / "view.html", record)
    carrying = next(s for s in playback.segments[0].step.stages if s.name == "cross").start + 0.2
    images, log = shoot(
        browser, tmp_path, ("t=0", f"t={carrying:.2f}", "step=3"), (900, 900), *SPATIAL
    )
    assert "Uncaught" not in log, log
    assert "Content Security Policy" not in log, log
    stage = [image[450:830, 30:870] for image in images]
    if pixels(stage[0], "#f1efea") > 0.95 * stage[0][..., 0].size:
        pytest.skip("this browser has no software WebGL")
    light = [(image[..., :3].min(-1) > 0.96).mean() for image in stage]
    assert all(share > 0.002 for share in light), "the white arm is there at all times"
    for a, b in ((0, 1), (1, 2), (0, 2)):
        changed = (np.abs(stage[a] - stage[b]).max(-1) > 0.1).mean()
        assert 0.01 < changed < 0.5, (a, b, changed)


@pytest.mark.browser
def test_the_page_says_what_the_arm_does(
    browser: str, tmp_path: Path, record: BuildRecord, playback: Playback
) -> None:
    write_page(arm_plan(COUNT), tmp_path / "view.html", record)
    address = (tmp_path / "view.html").as_uri()
    lost = playback.segments[1]
    assert lost.step.outcome == Outcome.GRASP_LOST
    stage = lost.step.stages[1]
    clock = (stage.start + stage.end) / 2 + lost.delay
    dom, log = browse(
        browser,
        tmp_path / "run",
        f"{address}#t={clock:.2f}",
        "--disable-gpu",
        "--disable-3d-apis",
        "--dump-dom",
        "--window-size=500,600",
    )
    root = re.search(r"<html[^>]*>", dom)
    assert root, log
    assert 'data-ready="yes"' in root[0], log
    assert "data-error" not in root[0]
    assert "The arm goes down to b2." in dom
    assert "attempt 2 of 8: grasp-lost" in dom
    assert "The rest of the build is planned anew" in dom
    assert re.findall(r'<tr data-segment="(\d+)" class="[^"]*current', dom) == ["1"]
    assert not re.findall(r'<tr data-step="\d+" class="[^"]*current', dom)
