"""Arms as data: files, limits, models, grippers."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import os
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.cli import main
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.export.robot_programs import export_program, replay_program
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.registry import Registry
from learn2assemble.robot.arm import (
    ARMS,
    COLLISION_GROUP,
    PICTURE_GROUP,
    Arm,
    arm_model,
    arm_spec,
    get_arm,
    load_arm,
)
from learn2assemble.robot.moves import Outcome
from learn2assemble.robot.own_arms import PLACE, register_arm
from learn2assemble.robot.urdf import arm_from_urdf

BOX, CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return get_arm(request.param)


@pytest.fixture
def third(tmp_path: Path) -> Path:
    """A copy of the Panda's folder under another name."""
    shutil.copytree(ARMS["panda"].parent, tmp_path / "mine")
    return tmp_path / "mine" / "arm.toml"


def at_rest(arm: Arm, pictures: bool = False) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The arm at home with open fingers."""
    model = arm_model(arm, pictures)
    data = mujoco.MjData(model)
    for name, angle in zip(arm.joints, arm.home, strict=True):
        data.joint(name).qpos[0] = angle
        data.actuator(name).ctrl[0] = angle
    for name in arm.gripper.joints:
        data.joint(name).qpos[0] = arm.gripper.max_width / 2
    data.actuator(arm.gripper.actuator).ctrl[0] = arm.gripper.open_command
    mujoco.mj_forward(model, data)
    return model, data


# ---------------------------------------------------------------- names and files


def test_there_are_two_arms_and_each_is_made_once() -> None:
    assert set(ARMS) == {"panda", "ur5e"}
    assert get_arm("panda") is get_arm("panda")
    assert [len(get_arm(name).joints) for name in ("panda", "ur5e")] == [7, 6]


def test_a_wrong_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match=r"arm: got 'pandas'.*did you mean 'panda'\?"):
        get_arm("pandas")
    with pytest.raises(UnknownNameError, match=r"did you mean 'elbow-up'\?"):
        get_arm("ur5e").limits("elbowup")


def test_a_third_arm_is_a_file(third: Path) -> None:
    text = third.read_text(encoding="utf-8").replace("[-0.5, 0.0, 0.0]", "[0.25, -0.5, 0.1]")
    third.write_text(text.replace("yaw = 0.0", "yaw = 1.5707963267948966"), encoding="utf-8")
    mine, panda = load_arm(third), get_arm("panda")
    assert mine.name == "mine"
    there, here = (forward(get_chain(arm), arm.home)[0] for arm in (mine, panda))
    x, y, z = here - panda.base_position
    np.testing.assert_allclose(there, [0.25 - y, -0.5 + x, 0.1 + z], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('tool = "tool"', 'tool = "tol"', r"site: got 'tol'.*did you mean 'tool'"),
        ('"joint7"]', '"joint8"]', r"joint: got 'joint8'.*did you mean"),
        ('"joint7"]', '"left_finger_joint"]', r"joints: got 'left_finger_joint'.*hinge"),
        ("home = [0.0,", "home = [3.0,", r"home: got .*within their limits"),
        ("home = [0.0, ", "home = [", r"home: got .*expected 7 numbers"),
        ("velocity = [2.175,", "velocity = [nan,", r"velocity: got .*7 numbers"),
        ("velocity = ", "speeds = ", r"velocity: got None, expected a value"),
        ("[gripper]", "[hand]", r"gripper: got None"),
        ('"panda.xml"', '"other.xml"', r"mjcf: got .*other.xml"),
        ('mjcf = "', "mjcf = ", r"expected valid TOML"),
        ("[base]", "[branches.odd]\njoint9 = [0, 1]\n[base]", r"branches.odd, joint: got 'joint9'"),
        ("[base]", "[branches.odd]\njoint4 = [0, 1]\n[base]", r"odd, joint4: got \[0, 1\]"),
    ],
)
def test_a_wrong_file_is_refused(third: Path, old: str, new: str, message: str) -> None:
    text = third.read_text(encoding="utf-8")
    assert old in text
    third.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_arm(third)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a file arm\.toml"):
        load_arm(tmp_path / "nothing" / "arm.toml")


def test_licences_and_sizes(arm: Arm) -> None:
    folder = arm.mjcf.parent
    for name, words in (("LICENSE", "WARRANTIES"), ("NOTICE", "Changed:")):
        assert words in (folder / name).read_text(encoding="utf-8")
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 600_000


# ---------------------------------------------------------------- the models


def test_arrays_fit_and_are_read_only(arm: Arm) -> None:
    for array in (arm.lower, arm.upper, arm.velocity, arm.acceleration, arm.jerk, arm.home):
        assert array.shape == (len(arm.joints),)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    assert arm.inside_limits(arm.home)
    assert not arm.inside_limits(arm.upper + 1e-3)
    for lower, upper in (arm.limits(), arm.limits("any"), *arm.branches.values()):
        assert ((arm.lower <= lower) & (lower < upper) & (upper <= arm.upper)).all()
        assert ((lower <= arm.home) & (arm.home <= upper)).all()


def test_home_points_the_tool_down_with_room_to_turn_the_hand(arm: Arm) -> None:
    position, rotation = forward(get_chain(arm), arm.home)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, -1], atol=2e-3)
    assert abs(rotation[1, 1]) > 0.999  # the fingers close along the world's y
    assert 0.15 < position[2] < 0.4
    assert (np.minimum(arm.home - arm.lower, arm.upper - arm.home)[-1]) > np.pi / 2


def test_geoms_are_named_and_grouped(arm: Arm) -> None:
    model, gripper = arm_model(arm, pictures=True), arm.gripper
    for k in range(model.ngeom):
        geom, body = model.geom(k), model.body(model.geom(k).bodyid[0]).name
        if geom.group[0] == PICTURE_GROUP:
            assert geom.name.startswith(f"{body}_v_")
            assert geom.contype[0] == geom.conaffinity[0] == 0
        else:
            assert geom.group[0] == COLLISION_GROUP
            assert int(geom.type[0]) in (int(BOX), int(CAPSULE))
            assert geom.name.startswith(f"{body}_c") or geom.name in gripper.pads
    for pad, finger in zip(gripper.pads, gripper.fingers, strict=True):
        geom = model.geom(pad)
        assert model.body(geom.bodyid[0]).name == finger
        assert (geom.friction[0], geom.condim[0], geom.priority[0]) == (1, 4, 1)
    assert (model.body_gravcomp[1:] == 1).all()
    plain = arm_model(arm)
    assert plain.nmesh == 0
    assert plain.ngeom == (model.geom_group == COLLISION_GROUP).sum()
    assert plain.body_mass.sum() == pytest.approx(model.body_mass.sum())


def distance(model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: np.ndarray):
    """Signed distance of float64[k, 3] to a box or capsule (negative inside) [m]."""
    local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
    size = model.geom_size[geom]
    if model.geom_type[geom] == BOX:
        out = np.abs(local) - size
        return np.linalg.norm(np.maximum(out, 0), axis=1) + np.minimum(out.max(1), 0)
    local[:, 2] -= np.clip(local[:, 2], -size[1], size[1])
    return np.linalg.norm(local, axis=1) - size[0]


def test_what_collides_covers_what_is_seen(arm: Arm) -> None:
    """Pictures stick out of the collision shapes by some millimetres at most."""
    model, data = at_rest(arm, pictures=True)
    for name in arm.gripper.joints:
        data.joint(name).qpos[0] = 0.025
    mujoco.mj_forward(model, data)
    hand = [model.body(name).id for name in (arm.gripper.hand, *arm.gripper.fingers)]
    for body in range(1, model.nbody):
        near = hand if body in hand else [body]
        shapes = [
            k
            for k in range(model.ngeom)
            if model.geom_bodyid[k] in near and model.geom_group[k] == COLLISION_GROUP
        ]
        for k in np.flatnonzero((model.geom_bodyid == body) & (model.geom_group == PICTURE_GROUP)):
            mesh = model.geom_dataid[k]
            start = model.mesh_vertadr[mesh]
            vertices = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
            points = vertices @ data.geom_xmat[k].reshape(3, 3).T + data.geom_xpos[k]
            out = np.min([distance(model, data, shape, points) for shape in shapes], axis=0)
            assert out.max() < 0.010, model.geom(k).name
    assert shapes


def test_the_arm_rests_at_home_without_touching_itself(arm: Arm) -> None:
    model, data = at_rest(arm)
    assert data.ncon == 0
    mujoco.mj_step(model, data, 500)
    assert data.ncon == 0
    joints = np.array([data.joint(name).qpos[0] for name in arm.joints])
    np.testing.assert_allclose(joints, arm.home, atol=1e-3)


@pytest.mark.parametrize("width", [0.0, 0.02, 0.05, 0.07])
def test_the_gripper_opens_to_the_commanded_width(arm: Arm, width: float) -> None:
    model, data = at_rest(arm)
    data.actuator(arm.gripper.actuator).ctrl[0] = arm.gripper.command(width)
    mujoco.mj_step(model, data, 1000)
    travel = [data.joint(name).qpos[0] for name in arm.gripper.joints]
    np.testing.assert_allclose(travel, width / 2, atol=5e-4)
    left, right = (data.geom(pad).xpos for pad in arm.gripper.pads)
    thickness = [2 * model.geom(pad).size[1] for pad in arm.gripper.pads]
    assert np.linalg.norm(left - right) - np.mean(thickness) == pytest.approx(width, abs=1e-3)
    # The pads face each other along the tool's y axis and hold the tool point between them.
    site = data.site(arm.tool)
    along = (left - right) @ site.xmat.reshape(3, 3)
    assert abs(along[0]) < 1e-6 and abs(along[2]) < 1e-6  # noqa: PT018
    assert np.linalg.norm((left + right) / 2 - site.xpos) < 0.003


def test_the_gripper_presses_with_its_force(arm: Arm) -> None:
    spec = arm_spec(arm)
    block = spec.worldbody.add_body(name="block", pos=forward(get_chain(arm), arm.home)[0])
    block.add_freejoint()
    block.gravcomp = 1
    block.add_geom(type=BOX, size=[0.025] * 3, mass=0.1)
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, angle in zip(arm.joints, arm.home, strict=True):
        data.joint(name).qpos[0] = data.actuator(name).ctrl[0] = angle
    for name in arm.gripper.joints:
        data.joint(name).qpos[0] = 0.03
    data.actuator(arm.gripper.actuator).ctrl[0] = arm.gripper.command(
        0.05 - arm.gripper.force / arm.gripper.stiffness
    )
    mujoco.mj_step(model, data, 500)
    pads = [model.geom(pad).id for pad in arm.gripper.pads]
    normal = dict.fromkeys(pads, 0.0)
    force = np.zeros(6)
    for k, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, k, force)
        for pad in pads:
            if pad in contact.geom:
                normal[pad] += force[0]
    np.testing.assert_allclose(list(normal.values()), arm.gripper.force, rtol=0.03)


def test_outcomes_have_the_names_of_the_contract() -> None:
    assert [outcome.label for outcome in Outcome] == [
        "reached",
        "unreachable",
        "grasp-collision",
        "place-collision",
        "grasp-lost",
        "disturbed-structure",
        "toppled",
        "dropped",
        "no-contact",
        "stopped",
    ]
    assert Outcome.REACHED == 0


# An arm of one's own, from its URDF to a program that is played.

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/arms/six.urdf"


def urdf(path: Path, *changes: tuple[str, str]) -> Path:
    """The example, with some text exchanged."""
    text = EXAMPLE.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    return path


def test_an_arm_from_its_urdf_builds_and_its_program_is_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = arm_from_urdf(urdf(tmp_path / "six.urdf"), tmp_path / "six")
    monkeypatch.setitem(ARMS._entries, "six", file)  # pyright: ignore[reportArgumentType]
    arm = get_arm("six", "suction")
    model = arm_model(arm)
    assert model.nu == len(arm.joints) == 6
    assert arm.velocity.tolist() == [2.5] * 3 + [3.1] * 3
    assert arm.inside_limits(arm.home)
    # The base moves with the arm, with its solids.
    moved = arm_model(get_arm("six", "suction", (1.0, 2.0, 0.0, 0.0)))
    assert moved.body("base_link").pos[:2].tolist() == [1.0, 2.0]
    plan = l2a.build(np.ones((3, 1, 2), bool), arm="six")
    assert plan.complete, plan.reason
    assert plan.arm is not None
    assert plan.arm.error_worst is not None
    assert plan.arm.error_worst < 1e-3
    assert plan.record is not None
    export_program(plan.record, "csv", tmp_path / "six.csv")
    assert replay_program(tmp_path / "six.csv", "six").same
    with pytest.raises(InputError, match="the arm six has no fingers"):
        get_arm("six", "gripper")
    # Without fingers it holds bricks by their studs.
    bricks = l2a.build("examples/bricks/stair.txt", kit="duplo", arm="six", physics="kinematic")
    assert bricks.complete, bricks.reason
    assert bricks.arm is not None
    assert bricks.arm.tool == "socket-large"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([('<cylinder radius="0.05" length="0.36"/>', '<mesh filename="gone.stl"/>')], "gone.stl"),
        ([('type="revolute"', 'type="prismatic"')], "joints: got 'j1', expected revolute"),
        ([(' velocity="2.5"', "")], "joint j1 without a velocity"),
        ([(' velocity="2.5"', ' velocity="fast"')], "could not convert string to float: 'fast'"),
        ([("</robot>", "")], "expected a URDF"),
        ([('<robot name="six">', "<box>"), ("</robot>", "</box>")], "begins with <robot>"),
    ],
    ids=["mesh", "slide", "no speed", "words", "cut", "other"],
)
def test_a_urdf_that_is_no_arm_is_refused_in_one_line(
    changes: list[tuple[str, str]],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = urdf(tmp_path / "six.urdf", *changes)
    assert main(["add-arm", str(file), "--out", str(tmp_path / "arms" / "six")]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1
    assert not (tmp_path / "arms" / "six").exists()


@pytest.mark.parametrize(
    ("name", "words"), [("panda", "a folder whose name no other arm has"), ("my arm", "letters")]
)
def test_an_arm_that_commands_would_not_know_is_not_made(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = urdf(tmp_path / "six.urdf")
    assert main(["add-arm", str(file), "--out", str(tmp_path / "arms" / name)]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "arms").exists()


def test_a_payload_that_cannot_be_leaves_no_arm(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="payload"):
        arm_from_urdf(urdf(tmp_path / "six.urdf"), tmp_path / "six", payload=-1.0)
    assert not (tmp_path / "six").exists()


def test_meshes_become_the_boxes_around_them(tmp_path: Path) -> None:
    import mujoco
    import trimesh

    solid = trimesh.creation.cylinder(0.05, 0.36)
    solid.export(tmp_path / "upper.stl")
    file = urdf(
        tmp_path / "six.urdf",
        ('<cylinder radius="0.05" length="0.36"/>', '<mesh filename="upper.stl"/>'),
    )
    model = arm_model(load_arm(arm_from_urdf(file, tmp_path / "six")))
    link = model.body("link2").id
    geom = int(model.body_geomadr[link])
    assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
    np.testing.assert_allclose(sorted(model.geom_size[geom]), [0.05, 0.05, 0.18], atol=1e-3)


def test_arms_in_the_folder_of_the_environment_are_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm_from_urdf(urdf(tmp_path / "six.urdf"), tmp_path / "arms" / "six")
    table: Registry[Path] = Registry("arm", {})
    monkeypatch.setenv(PLACE, str(tmp_path / "arms"))
    register_arm(table)
    assert dict(table) == {"six": (tmp_path / "arms" / "six" / "arm.toml").resolve()}
    # A name that is taken: of which folder, and who names that.
    (tmp_path / "arms" / "six").rename(tmp_path / "arms" / "panda")
    with pytest.raises(
        InputError, match=f"{PLACE}: got '.*arms.panda', expected a folder whose name"
    ):
        register_arm(Registry("arm", {"panda": tmp_path}))
    monkeypatch.setenv(PLACE, os.devnull)
    with pytest.raises(InputError, match=f"{PLACE}.*a folder with a folder for each arm"):
        register_arm(table)
