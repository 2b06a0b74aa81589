"""Records of an arm's build: files, their bytes, and the check that finds what is wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arm_record import arm_record
from learn2assemble.errors import InputError
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.motion.files import (
    csv_header,
    read_record,
    record_data,
    record_from,
    write_csv,
    write_record,
)
from learn2assemble.motion.record import (
    BuildRecord,
    Samples,
    Stage,
    StepRecord,
    find_fault,
    require_sound,
)
from learn2assemble.motion.recorder import (
    LOST,
    BuildRecorder,
    StepMotion,
    holding,
    stages_of,
    upright,
)
from learn2assemble.robot.arm import get_arm
from learn2assemble.robot.grasps import get_grasps
from learn2assemble.robot.moves import OPENING, STAGES, Move, Outcome, Scene, Trajectory


@pytest.fixture(scope="module")
def record() -> BuildRecord:
    """Six blocks; grasp-lost, unreachable and dropped happen on the way."""
    return arm_record("panda", 6)


def assert_same(a: Any, b: Any) -> None:
    """Dataclasses, tuples and arrays, equal to the rounding of the files."""
    if isinstance(a, np.ndarray):
        np.testing.assert_allclose(a, b, rtol=0, atol=0.51e-6)
    elif isinstance(a, float):
        assert a == pytest.approx(b, abs=0.51e-6)
    elif isinstance(a, BuildRecord | StepRecord | Samples) or hasattr(a, "__dataclass_fields__"):
        for name in a.__dataclass_fields__:
            assert_same(getattr(a, name), getattr(b, name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_a_record_comes_back_from_its_file(tmp_path: Path, name: str) -> None:
    record = arm_record(name, 4)
    write_record(record, tmp_path / "a.json")
    again = read_record(tmp_path / "a.json")
    assert_same(record, again)
    assert [step.outcome for step in again.steps] == [
        Outcome.REACHED,
        Outcome.GRASP_LOST,
        Outcome.REACHED,
        Outcome.REACHED,
    ]
    assert find_fault(again) is None
    write_record(again, tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_the_table_holds_the_same_numbers(tmp_path: Path, record: BuildRecord) -> None:
    write_csv(record, tmp_path / "a.csv")
    wanted, numbers = record.joined()
    head, first, *rest = (tmp_path / "a.csv").read_text().splitlines()
    steps, stages, *columns = zip(*(line.split(",") for line in (first, *rest)), strict=True)
    np.testing.assert_array_equal(np.array(steps, int), numbers)
    values = [wanted.time, *wanted.joints.T, *wanted.velocity.T, wanted.width]
    assert_same(np.array(columns, float), np.array(values))
    assert set(stages) <= {"", *(s.name for step in record.steps for s in step.stages)}
    assert stages[0] == "approach"
    assert stages[-1] == "home"
    assert head == ",".join(csv_header(record.arm.joints))
    assert "time [s]" in head
    assert "joint7 velocity [rad/s]" in head
    assert head.endswith("gripper width [m]")
    assert "-0.000000" not in first
    assert len(rest) == len(numbers) - 1
    write_csv(replace(record, steps=read_back(record).steps), tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def read_back(record: BuildRecord) -> BuildRecord:
    return record_from(json.loads(json.dumps(record_data(record))))


@given(st.lists(st.floats(-7, 7), min_size=7, max_size=7), st.floats(-1e-9, 1e-9))
@settings(max_examples=50, deadline=None)
def test_any_numbers_survive_and_give_the_same_bytes(row: list[float], tiny: float) -> None:
    plain = arm_record("panda", 2, failures=False)
    samples = plain.steps[0].samples
    joints = samples.joints.copy()
    joints[0] = row
    record = sampled(plain, 0, joints=joints, velocity=samples.velocity + tiny)
    data = record_data(record)
    again = record_from(json.loads(json.dumps(data)))
    np.testing.assert_allclose(again.steps[0].samples.joints[0], row, rtol=0, atol=0.51e-6)
    assert json.dumps(record_data(again)) == json.dumps(data)
    assert "-0.0," not in json.dumps(data)


def test_a_file_has_one_line_per_row_of_numbers(tmp_path: Path, record: BuildRecord) -> None:
    write_record(record, tmp_path / "a.json")
    lines = (tmp_path / "a.json").read_text().splitlines()
    samples = sum(len(step.samples.time) for step in record.steps)
    assert 2 * samples < len(lines) < 2 * samples + 60 * len(record.steps) + 100


def change(data: dict[str, Any], *path: Any) -> Callable[[Any], None]:
    """Sets what a path leads to."""
    for key in path[:-1]:
        data = data[key]
    return lambda value: data.__setitem__(path[-1], value)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("format",), "other", "learn2assemble-trajectory"),
        (("version",), 6, "trajectory.version: got 6, expected 5"),
        (("version",), 2, "trajectory.version: got 2, expected 5"),
        (("version",), "3", "trajectory.version"),
        (("arm", "lower"), [0.0], "arm.lower"),
        (("arm", "max_width"), "wide", "arm.max_width"),
        (("arm",), None, "trajectory"),
        (("objects",), 5, "trajectory"),
        (("rate",), float("nan"), "rate"),
        (("steps", 0, "outcome"), "reachd", "did you mean 'reached'"),
        (("steps", 0, "stages", 0, 0), "aproach", "did you mean 'approach'"),
        (("steps", 0, "stages", 0, 1), None, "steps[0].stages"),
        (("steps", 1, "joints"), [[1.0]], "steps[1].joints"),
        (("steps", 1, "width", 3), float("inf"), "steps[1].width"),
        (("steps", 1, "joints", 3, 0), 1e9, "steps[1].joints"),
        (("steps", 0, "target", 0), 1e300, "steps[0].target"),
        (("steps", 0, "after"), [[0, 0, 0]], "steps[0].after"),
        (("steps", 0, "grip"), "late", "steps[0].grip"),
        (("steps", 0, "target"), [0, 0, 0], "steps[0].target"),
        (("steps", 2), 7, "steps[2]"),
    ],
)
def test_nonsense_is_refused_in_one_line(
    record: BuildRecord, path: tuple[Any, ...], value: Any, words: str
) -> None:
    data = json.loads(json.dumps(record_data(record)))
    change(data, *path)(value)
    with pytest.raises(InputError) as caught:
        record_from(data)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_field_is_missed(record: BuildRecord) -> None:
    for where in ((), ("arm",), ("steps", 0)):
        data = json.loads(json.dumps(record_data(record)))
        part = data
        for key in where:
            part = part[key]
        for name in [key for key in part if key not in ("format", "version", "units")]:
            kept = part.pop(name)
            with pytest.raises(InputError, match=name):
                record_from(data)
            part[name] = kept
        record_from(data)


def test_files_that_are_none_are_refused(tmp_path: Path, record: BuildRecord) -> None:
    (tmp_path / "text").write_text("hello")
    for name, what in (("text", "JSON"), ("none", "no such file")):
        with pytest.raises(InputError, match=what):
            read_record(tmp_path / name)
    with pytest.raises(InputError, match="learn2assemble-trajectory"):
        record_from([1])
    for write in (write_record, write_csv):
        with pytest.raises(InputError, match="can be written"):
            write(record, tmp_path / "no" / "file")
    broken = replace(record, rate=math.nan)
    with pytest.raises(InputError, match="finite"):
        write_record(broken, tmp_path / "a.json")


# ---------------------------------------------------------------- what is wrong


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_a_sound_record_has_no_fault(name: str) -> None:
    record = arm_record(name, 8)
    assert find_fault(record) is None
    require_sound(record)
    assert {step.outcome.label for step in record.steps} == {
        "reached",
        "grasp-lost",
        "unreachable",
        "dropped",
    }


def sampled(record: BuildRecord, k: int, **arrays: np.ndarray) -> BuildRecord:
    """The record with other samples in step k."""
    return stepped(record, k, samples=replace(record.steps[k].samples, **arrays))


def stepped(record: BuildRecord, k: int, **fields: Any) -> BuildRecord:
    """The record with another step k."""
    steps = list(record.steps)
    steps[k] = replace(steps[k], **fields)
    return replace(record, steps=tuple(steps))


def added(array: np.ndarray, where: Any, value: float) -> np.ndarray:
    copy = array.copy()
    copy[where] += value
    return copy


def faulty(record: BuildRecord) -> dict[str, tuple[BuildRecord, str]]:
    """Every kind of fault, provoked in step 3 where it can be, and the words that tell."""
    step, arm = record.steps[2], record.arm
    s, start = step.samples, float(step.samples.time[0])
    half = len(s.time) // 2
    last = record.steps[1]
    wave = 0.004 * np.sin(2 * np.pi * 12 * s.time)[:, None] * np.ones(7)
    beat = 0.004 * 24 * np.pi * np.cos(2 * np.pi * 12 * s.time)[:, None] * np.ones(7)
    grip = step.grip or 0.0
    nan = added(s.width, 4, np.nan)
    return {
        "position": (
            replace(record, arm=replace(arm, lower=added(arm.lower, 3, 0.5))),
            "joint4 is at",
        ),
        "velocity": (
            replace(record, arm=replace(arm, velocity=0.3 * arm.velocity)),
            "rad/s, limit",
        ),
        "mean velocity": (
            sampled(record, 2, joints=added(s.joints, np.s_[half:, 1], 0.2)),
            "moves at",
        ),
        "acceleration": (
            sampled(record, 2, velocity=s.velocity + beat, joints=s.joints + wave),
            "accelerates",
        ),
        "rest": (
            sampled(record, 0, velocity=added(record.steps[0].samples.velocity, np.s_[:, 2], 0.4)),
            "joint3 accelerates",
        ),
        "jump": (sampled(record, 2, joints=added(s.joints, np.s_[half:, 1], 0.02)), "joint2 jumps"),
        "jump between steps": (
            sampled(record, 2, joints=added(s.joints, np.s_[:, 5], 0.02)),
            "joint6 jumps",
        ),
        "width": (sampled(record, 2, width=s.width + 0.05), "gripper is open"),
        "negative width": (sampled(record, 2, width=added(s.width, 9, -0.07)), "gripper is open"),
        "width jump": (
            sampled(record, 2, width=added(s.width, np.s_[half:], 0.022)),
            "the gripper jumps",
        ),
        "time": (sampled(record, 2, time=added(s.time, half, 0.003)), "it should be at"),
        "late": (sampled(record, 2, time=s.time + 0.02), "it should be at"),
        "stage": (stepped(record, 2, stages=(Stage("lift", start - 1, start),)), "stage lift"),
        "stage order": (
            stepped(
                record,
                2,
                stages=(Stage("lift", start, start + 1), Stage("place", start + 0.5, start + 2)),
            ),
            "stage place",
        ),
        "objects": (replace(record, objects=((0, 1), (1,), (2, 3, 4, 5))), "each once"),
        "cells": (stepped(record, 2, cells=(1, 2)), "no object of the build"),
        "cells twice": (stepped(record, 2, cells=(2, 2)), "no object of the build"),
        "number": (stepped(record, 2, number=9), "should have number 3"),
        "rate": (replace(record, rate=0.0), "samples per second"),
        "limits": (replace(record, arm=replace(arm, upper=np.ones(3))), "3 numbers for 7 joints"),
        "before": (stepped(record, 2, before=step.before[:3]), "6 cells"),
        "quaternion": (stepped(record, 2, after=2 * step.after), "not of length 1"),
        "samples": (sampled(record, 2, width=s.width[:-1]), "differ in number"),
        "finite": (sampled(record, 2, width=nan), "not finite"),
        "never held": (stepped(record, 2, grip=None, release=None), "never held and released"),
        "reached and still held": (stepped(record, 2, release=None), "never held and released"),
        "no grip": (
            stepped(record, 2, grip=None, outcome=Outcome.DROPPED, detail="x"),
            "but never held",
        ),
        "held too long": (stepped(record, 2, release=1e3), "outside"),
        "held backwards": (stepped(record, 2, release=grip - 0.5), "outside"),
        "no reason": (stepped(record, 2, outcome=Outcome.TOPPLED), "without a reason"),
        "moved by nobody": (
            stepped(record, 1, after=added(last.after, (4, 0), 0.01)),
            "cell 4 does not begin",
        ),
    }


def test_every_kind_of_fault_is_found_and_told_in_one_line(record: BuildRecord) -> None:
    assert find_fault(record) is None
    for name, (broken, words) in faulty(record).items():
        fault = find_fault(broken)
        assert fault is not None, name
        assert words in fault, (name, fault)
        assert "\n" not in fault
        with pytest.raises(InputError) as caught:
            require_sound(broken)
        assert words in str(caught.value), name
    assert "step 3, t = " in (find_fault(faulty(record)["jump"][0]) or "")


def test_an_object_held_without_a_motion_is_a_fault(record: BuildRecord) -> None:
    unreachable = next(k for k, s in enumerate(record.steps) if s.outcome == Outcome.UNREACHABLE)
    when = record.spans()[unreachable][0]
    fault = find_fault(stepped(record, unreachable, grip=when, release=when))
    assert fault is not None
    assert "without a motion" in fault


@given(st.integers(0, 6), st.floats(1.001, 3), st.data())
@settings(max_examples=30, deadline=None)
def test_no_limit_is_exceeded_unseen(joint: int, times: float, data: st.DataObject) -> None:
    """Limits just below what the motion needs: each of them is missed by name."""
    record = arm_record("panda", 3)
    samples, _ = record.joined()
    pace = np.abs(samples.velocity).max(0)
    limit = data.draw(st.sampled_from(["velocity", "acceleration"]))
    if limit == "acceleration":
        pace = np.abs(np.diff(samples.velocity, axis=0)).max(0) * record.rate
    if pace[joint] < 0.01:
        return
    limits = getattr(record.arm, limit).copy()
    limits[joint] = pace[joint] / times - 2e-3
    fault = find_fault(replace(record, arm=replace(record.arm, **{limit: limits})))
    assert fault is not None
    assert record.arm.joints[joint] in fault


# ---------------------------------------------------------------- recording


def test_steps_are_put_on_one_clock() -> None:
    arm = get_arm("panda")
    poses = upright(np.array([[0, 0, 0.025], [0.2, 0, 0.025]]), np.zeros(2))
    book = BuildRecorder(arm, arm.home, 0.05, poses, [[0], [1]], "test")
    order: dict[str, Any] = {"plan_step": 1, "cells": [1], "target": poses[1]}
    book.add(**order, outcome=Outcome.UNREACHABLE, detail="too far")
    book.replanned()
    after = added(poses, (1, 0), 0.1)
    width = np.full(10, 0.05)
    still = np.tile(arm.home, (10, 1)), np.zeros((10, 7)), width, width
    motion = StepMotion(*still, (Stage("lift", 0.0, 0.2),), 0.04, 0.1)
    for _ in range(2):
        book.add(
            **order,
            motion=motion,
            outcome=Outcome.DROPPED,
            detail="lost",
            after=after,
        )
    book.number_steps([None, 1, 1])
    record = book.record()
    assert find_fault(record) is None
    assert record.spans() == [(0, 0), (0, 0.2), (0.2, 0.4)]
    assert [len(step.samples.time) for step in record.steps] == [0, 11, 10]
    assert [step.plan_step for step in record.steps] == [None, 1, 1]
    assert [step.replanned for step in record.steps] == [True, False, False]
    assert record.steps[2].grip == pytest.approx(0.24)
    assert record.steps[2].stages == (Stage("lift", 0.2, 0.4),)
    assert record.steps[2].seconds == pytest.approx(0.18)
    assert record.steps[1].error == pytest.approx(0.1)
    np.testing.assert_array_equal(record.steps[1].before, poses)
    assert record.steps[1].stage_at(0.1) == "lift"
    assert record.steps[1].stage_at(0.3) == ""


def test_what_a_cell_reports_becomes_a_record() -> None:
    """Two blocks on top of another by the dynamic cell, and one let go of in mid-air."""
    arm = get_arm("panda")
    cell = DynamicCell(arm)
    place = np.array([[0, 0, 0.025], [0, -0.25, 0.025], [0.12, -0.25, 0.025], [0.2, -0.2, 0.025]])
    scene = Scene(place, np.zeros(4), np.arange(4), 1)
    poses, objects = upright(place, np.zeros(4)), [[k] for k in range(4)]
    book = BuildRecorder(arm, arm.home, OPENING, poses, objects, "test")
    pair = get_grasps("paper")[0]
    numbers, joints, quaternion = np.array([0, 1, 2, 3]), None, None
    for row, height in ((2, 0.075), (3, 0.125), (3, 0.3)):
        move = Move(row, np.array([0, 0, height]), *pair)
        found = cell.attempt(scene, move, joints=joints, quaternion=quaternion)
        numbers = book.add_attempt(found, scene, move, numbers)
        assert found.after is not None
        scene, quaternion, joints = found.after, found.quaternion, found.joints
    record = book.record()
    assert find_fault(record) is None
    first, second, third = record.steps
    assert (first.outcome, second.outcome) == (Outcome.REACHED, Outcome.REACHED)
    assert (first.cells, second.cells) == ((2,), (3,)), "rows of the scene change, cells do not"
    assert numbers.tolist() == [0, 2, 3, 1]
    assert third.outcome != Outcome.REACHED
    assert first.error < 0.001
    np.testing.assert_allclose(first.after[2, :3], [0, 0, 0.075], atol=1e-3)
    np.testing.assert_allclose(first.after[[0, 1, 3]], first.before[[0, 1, 3]], atol=1e-3)
    assert [s.name for s in first.stages] == list(STAGES)
    lift, release = first.stages[2], first.stages[5]
    assert first.grip == pytest.approx(lift.start)
    assert first.release == pytest.approx(release.start)
    assert second.stages[0].start == first.stages[-1].end == first.samples.time[-1]


def test_what_slips_is_not_held_any_more() -> None:
    arm = get_arm("panda")
    count = 8
    where, _ = forward(get_chain(arm), arm.home)
    pose = np.tile([*where, 1, 0, 0, 0], (count, 1, 1)).astype(float)
    stage = np.array([0, 1, 1, 2, 2, 3, 3, 3], np.int8)

    def made(pose: np.ndarray, stage: np.ndarray) -> Trajectory:
        still = np.zeros((count, 7))
        return Trajectory(
            0.02 * np.arange(count),
            still + arm.home,
            still,
            np.full(count, 0.05),
            np.full(count, 0.05),
            stage,
            pose,
        )

    assert holding(arm, made(pose, stage), 0) == (0.04, None), "still in the hand at the end"
    slipped = pose.copy()
    slipped[6:, 0, 2] -= 1.01 * LOST
    grip, release = holding(arm, made(slipped, stage), 0)
    assert (grip, release) == (pytest.approx(0.04), pytest.approx(0.1))
    assert holding(arm, made(pose, np.minimum(stage, 1)), 0) == (None, None)
    spans = [(s.name, round(s.start, 3), round(s.end, 3)) for s in stages_of(made(pose, stage))]
    assert spans == [("pick", 0.0, 0.04), ("lift", 0.04, 0.08), ("cross", 0.08, 0.14)]


def test_a_suction_tool_is_told_on_or_off(record: BuildRecord) -> None:
    cup = replace(record.arm, tool_name="suction", suction=True, max_width=0.0)
    steps = tuple(
        replace(
            step,
            samples=replace(
                step.samples,
                width=0 * step.samples.width,
                command=np.round(step.samples.width / 0.06),
            ),
        )
        for step in record.steps
    )
    held = replace(record, arm=cup, steps=steps, half=np.full((record.num_cells, 3), 0.025))
    assert find_fault(held) is None
    again = record_from(json.loads(json.dumps(record_data(held))))
    assert again.arm.suction
    assert again.arm.tool_name == "suction"
    np.testing.assert_array_equal(again.half, held.half)
    np.testing.assert_array_equal(again.steps[0].samples.command, steps[0].samples.command)
    half = replace(steps[0].samples, command=steps[0].samples.command + 0.5)
    wrong = replace(held, steps=(replace(steps[0], samples=half), *steps[1:]))
    assert "neither 0 nor 1" in str(find_fault(wrong))
    assert "three lengths" in str(find_fault(replace(held, half=np.zeros((1, 3)))))
