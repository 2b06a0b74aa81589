"""An arm of one's own, from its URDF to a program that is played."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.cli import main
from learn2assemble.errors import InputError
from learn2assemble.export.robot_programs import export_program, replay_program
from learn2assemble.registry import Registry
from learn2assemble.robot.arm import arm_model, get_arm, load_arm
from learn2assemble.robot.own_arms import PLACE, register_arm
from learn2assemble.robot.registry import ARMS
from learn2assemble.robot.urdf import arm_from_urdf

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
    monkeypatch.setenv(PLACE, os.devnull)
    with pytest.raises(InputError, match=f"{PLACE}.*a folder with a folder for each arm"):
        register_arm(table)
