"""Programs of robots: limits between samples, and files that independent readers understand."""

from __future__ import annotations

import csv
import dataclasses
import gzip
import io
import itertools
import json
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly, PPoly

from arm_record import arm_record
from learn2assemble.cell.site import read_site
from learn2assemble.cli import main
from learn2assemble.errors import InputError, MissingExtraError, UnknownNameError
from learn2assemble.export import PROGRAM_FORMATS
from learn2assemble.export.robot_programs import (
    PROGRAMS,
    export_program,
    read_program,
    replay_program,
)
from learn2assemble.export.urscript import BLEND, ROUND, held_centre, planned_frame, write_urscript
from learn2assemble.handling.dry_run import play
from learn2assemble.handling.dynamic_cell import DynamicCell
from learn2assemble.kinematics.chain import forward, get_chain
from learn2assemble.motion.driver import driver_of
from learn2assemble.motion.files import write_record
from learn2assemble.motion.knots import Knots, fit, slow_down, usage
from learn2assemble.motion.program import Program, Wait, make_program, motions
from learn2assemble.motion.record import BuildRecord, ByHand, find_fault
from learn2assemble.motion.recorder import BuildRecorder, CellShapes, upright
from learn2assemble.motion.waits import BY_HAND
from learn2assemble.plants.settings import ProgramSettings, ToolOutput
from learn2assemble.robot.arm import Arm, Limits, arm_model, get_arm
from learn2assemble.robot.grasps import Attitude
from learn2assemble.robot.moves import OPENING, Move, Scene
from robot_scenes import cell, scene

ARMS = ("panda", "ur5e")


def program_of(name: str, count: int = 5, failures: bool = True) -> Program:
    return make_program(arm_record(name, count, failures), get_arm(name))


# ---------------------------------------------------------------- limits everywhere


def extremes(knots: Knots) -> list[tuple[np.ndarray, np.ndarray]]:
    """Smallest and largest position, velocity, acceleration and jerk per joint, by SciPy: where
    the derivative of each is 0, and at the knots from both sides."""
    values = np.stack([knots.position, knots.velocity, knots.acceleration], axis=1)
    found = []
    curve = PPoly.from_bernstein_basis(BPoly.from_derivatives(knots.time, values))
    for order in range(4):
        low, high = [], []
        for joint in range(values.shape[2]):
            now = PPoly(curve.c[:, :, joint], curve.x).derivative(order)
            roots = now.derivative().roots(extrapolate=False)
            h = np.diff(now.x)
            ends = [now.c[-1], sum(c * h ** (len(now.c) - 1 - k) for k, c in enumerate(now.c))]
            inner = now(roots[np.isfinite(roots)])
            every = np.concatenate([*ends, inner])
            low.append(every.min())
            high.append(every.max())
        found.append((np.array(low), np.array(high)))
    return found


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(2, 40),
    reach=st.floats(1e-4, 1.0),
    speed=st.floats(0.0, 3.0),
    even=st.booleans(),
)
def test_limits_hold_between_any_samples(
    seed: int, count: int, reach: float, speed: float, even: bool
) -> None:
    rng = np.random.default_rng(seed)
    joints = 3
    time = np.cumsum(np.full(count, 0.02) if even else rng.uniform(0.01, 0.1, count))
    position = np.cumsum(rng.normal(0, reach, (count, joints)), axis=0)
    velocity = rng.normal(0, speed, (count, joints))
    velocity[[0, -1]] = 0.0
    whole = np.full(joints, 1e6)
    limits = Limits(
        rng.uniform(0.5, 3, joints),
        rng.uniform(1, 20, joints),
        rng.uniform(50, 5000, joints),
        -whole,
        whole,
    )
    motion, factor = slow_down(fit(time, position, velocity), limits)
    assert factor >= 1
    # The same path: the samples are still on it, and it runs in the same directions there.
    assert np.array_equal(motion.position, position)
    assert np.allclose(motion.velocity * factor, velocity, rtol=1e-12, atol=1e-12)
    (low, high), *derivatives = extremes(motion)
    bounds = motion.bounds()
    slack = 1e-9 * (1 + np.abs(position).max())
    assert (bounds.lower.min(0) <= low + slack).all()
    assert (bounds.upper.max(0) >= high - slack).all()
    for (least, most), limit, bound in zip(derivatives, limits, bounds, strict=False):
        size = np.maximum(-least, most)
        assert (size <= limit * (1 + 1e-9)).all()
        assert (bound.max(0) >= size * (1 - 1e-6) - 1e-9).all()
        # The bound is not much more than the truth, else motions would be slowed down for nothing.
        assert (bound.max(0) <= 1.35 * size + 1e-6).all()
    if factor > 1:
        used = max(
            float((np.maximum(-least, most) / limit).max())
            for (least, most), limit in zip(derivatives, limits, strict=False)
        )
        assert used > 0.5
    # Densely sampled, by differences of positions alone.
    fine = np.linspace(motion.time[0], motion.time[-1], 4001)
    q = motion.at(fine)[0]
    for order, limit in enumerate(limits[:3], 1):
        step = fine[1] - fine[0]
        noise = 2**order * 1e-15 * (1 + np.abs(q).max()) * 4 / step**order
        assert (np.abs(np.diff(q, order, axis=0)) / step**order <= limit * (1 + 1e-6) + noise).all()


def test_the_jerk_has_no_jumps_within_a_motion() -> None:
    rng = np.random.default_rng(4)
    time, position = np.arange(30) * 0.02, np.cumsum(rng.normal(0, 0.01, (30, 2)), axis=0)
    velocity = rng.normal(0, 0.3, (30, 2))
    motion = fit(time, position, velocity)
    values = np.stack([motion.position, motion.velocity, motion.acceleration], axis=1)
    jerk = BPoly.from_derivatives(time, values).derivative(3)
    inner = time[1:-1]
    before, after = jerk(inner - 1e-9), jerk(inner + 1e-9)
    assert np.allclose(before, after, rtol=1e-3, atol=1e-3 * np.abs(before).max())
    assert np.array_equal(motion.acceleration[[0, -1]], np.zeros((2, 2)))


def test_a_joint_that_leaves_its_range_between_samples_is_refused() -> None:
    time, position = np.arange(3) * 0.1, np.array([[0.0], [0.999], [0.0]])
    velocity = np.array([[0.0], [0.9], [0.0]])
    limits = Limits(*(np.full(1, 1e9) for _ in range(3)), np.full(1, -1.0), np.full(1, 1.0))
    with pytest.raises(InputError, match=r"expected -1.000000 to 1.000000 rad between the samples"):
        slow_down(fit(time, position, velocity), limits)


@pytest.mark.parametrize("name", ARMS)
def test_a_build_is_within_the_limits_of_its_arm(name: str) -> None:
    program, limits = program_of(name), get_arm(name).bounds
    assert max(usage(program.knots, limits).values()) <= 1
    (low, high), *derivatives = extremes(program.knots)
    assert (low >= limits.lower).all()
    assert (high <= limits.upper).all()
    for (least, most), limit in zip(derivatives, limits, strict=False):
        assert (np.maximum(-least, most) <= limit).all()
    record = arm_record(name, 5)
    samples = record.joined()[0]
    # Every recorded position is passed, in order.
    kept = np.isin(np.round(samples.joints, 6), np.round(program.knots.position, 6)).all()
    assert kept
    assert program.seconds >= samples.time[-1]


def test_a_record_beyond_the_jerk_of_an_arm_is_slowed_down() -> None:
    arm = get_arm("ur5e")
    slow = dataclasses.replace(arm, jerk=arm.jerk / 20)
    record = arm_record("ur5e", 3, failures=False)
    program = make_program(record, slow)
    assert program.stretch > 1.2
    assert max(usage(program.knots, slow.bounds).values()) <= 1
    assert program.seconds > record.joined()[0].time[-1] * 1.1


# ---------------------------------------------------------------- what the tool is told


@pytest.mark.parametrize("name", ARMS)
def test_the_gripper_is_told_what_was_meant_not_what_was_simulated(name: str) -> None:
    program, arm = program_of(name), get_arm(name)
    widths = {state.width for state in program.states}
    assert widths == {OPENING, 0.05}
    assert all(
        state.force == (arm.gripper.force if state.width == 0.05 else 0) for state in program.states
    )
    assert all(a.time <= b.time for a, b in itertools.pairwise(program.states))
    # It only moves while the arm stands still, and has the time it takes.
    for before, state in itertools.pairwise(program.states):
        if state.width != before.width:
            way = abs(state.width - before.width) / state.speed
            span = np.linspace(state.time, state.time + way, 9)
            assert not program.motion[program.knots.pieces(span)].any()
    # What is lifted is held, and known to the controller.
    reached = [step for step in program.steps if step.checks]
    assert len(reached) == 4
    for step in reached:
        for time in step.checks:
            state = program.states[int(program.states_at(np.array([time]))[0])]
            assert state.force > 0
            assert state.load == pytest.approx(0.1)
            assert step.held is not None
            assert step.held[0] <= time <= step.held[1]


# ---------------------------------------------------------------- frames


def craig(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
    """Link frame by modified Denavit-Hartenberg parameters."""
    (c, s), (ca, sa) = (math.cos(theta), math.sin(theta)), (math.cos(alpha), math.sin(alpha))
    return np.array(
        [
            [c, -s, 0, a],
            [s * ca, c * ca, -sa, -d * sa],
            [s * sa, c * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    )


def classic(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
    """Link frame by standard Denavit-Hartenberg parameters."""
    (c, s), (ca, sa) = (math.cos(theta), math.sin(theta)), (math.cos(alpha), math.sin(alpha))
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    )


def frame(pose: np.ndarray) -> np.ndarray:
    out, turn = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(turn, pose[3:])
    out[:3, :3], out[:3, 3] = turn.reshape(3, 3), pose[:3]
    return out


def flange(name: str, q: np.ndarray) -> np.ndarray:
    """Flange in the base by the parameters the makers publish."""
    right = math.pi / 2
    if name == "panda":
        a, alpha = (0, 0, 0, 0.0825, -0.0825, 0, 0.088), (0, -1, 1, 1, -1, 1, 1)
        links = zip(a, alpha, (0.333, 0, 0.316, 0, 0.384, 0, 0), q, strict=True)
        chain = [craig(a, al * right, d, th) for a, al, d, th in links]
        return np.linalg.multi_dot([*chain, craig(0, 0, 0.107, 0)])
    a, alpha = (0, -0.425, -0.3922, 0, 0, 0), (1, 0, 0, 1, -1, 0)
    links = zip(a, alpha, (0.1625, 0, 0, 0.1333, 0.0997, 0.0996), q, strict=True)
    return np.linalg.multi_dot([classic(a, al * right, d, th) for a, al, d, th in links])


@pytest.mark.parametrize(("name", "close"), [("panda", 1e-6), ("ur5e", 3e-3)])
def test_joints_and_frames_are_those_of_the_makers(name: str, close: float) -> None:
    """Base, flange and tool point, at any joints; the UR5e's model is rounded to millimetres."""
    arm, rng = get_arm(name), np.random.default_rng(1)
    driver = driver_of(arm)
    for _ in range(10):
        q = rng.uniform(arm.lower, arm.upper)
        position, rotation = forward(get_chain(arm), q)
        found = frame(driver.base) @ flange(name, q) @ frame(driver.tcp)
        assert np.abs(found[:3, 3] - position).max() <= close
        assert np.abs(found[:3, :3] - rotation).max() <= 1e-6


# ---------------------------------------------------------------- tables


def table(path: Path) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Header and lines, with nothing but the standard library."""
    text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    lines = text.decode().splitlines()
    head = [line[2:].split(": ", 1) for line in lines if line.startswith("#")]
    body = [line for line in lines if not line.startswith("#")]
    return {key: json.loads(value) for key, value in head}, list(csv.DictReader(body))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Path]:
    """Every format of both arms."""
    found = {}
    for name, format in itertools.product(ARMS, PROGRAMS):
        if (name, format) not in {("panda", "urscript"), ("ur5e", "franka")}:
            folder = tmp_path_factory.mktemp(f"{name}-{format}")
            found[name, format] = export_program(arm_record(name, 4), format, folder).file
    return found


@pytest.mark.parametrize(("name", "format"), [("panda", "franka"), ("ur5e", "csv")])
def test_a_table_can_be_streamed(
    files: dict[tuple[str, str], Path], name: str, format: str
) -> None:
    """Differences of the lines alone, as a controller sees them, respect every limit."""
    arm = get_arm(name)
    assert not re.search(r",-0\.0+[,\n]", files[name, format].read_text())
    head, rows = table(files[name, format])
    joints = driver_of(arm).joints
    assert head["joints"] == list(joints)
    assert len(rows) == head["rows"]
    time = np.array([float(row["time"]) for row in rows])
    assert np.allclose(np.diff(time), 1e-3, atol=1e-9)
    q = np.array([[float(row[f"q_{joint}"]) for joint in joints] for row in rows])
    limits = arm.bounds
    assert ((q >= limits.lower - 1e-6) & (q <= limits.upper + 1e-6)).all()
    for order, (key, limit) in enumerate(zip(("dq", "ddq", ""), limits[:3], strict=True), 1):
        share = np.abs(np.diff(q, order, axis=0) * 1e3**order) / limit
        assert share.max() <= 1.002
        if key:
            given = np.array([[float(row[f"{key}_{joint}"]) for joint in joints] for row in rows])
            assert (np.abs(given) <= limit).all()
    # At rest at both ends, and whenever the gripper moves.
    assert np.allclose(q[[0, -2]], q[[1, -1]], rtol=0, atol=1e-6)
    moving = np.array([int(row["motion"]) for row in rows])
    width = np.array([float(row["width"]) for row in rows])
    assert set(width) == {OPENING, 0.05}
    assert not moving[np.flatnonzero(np.diff(width)) + 1].any()
    assert {row["stage"] for row in rows} >= {"approach", "pick", "lift", "cross", "place"}


def test_a_franka_table_says_what_libfranka_is_to_call(
    files: dict[tuple[str, str], Path],
) -> None:
    head, _ = table(files["panda", "franka"])
    calls = [call["call"] for call in head["calls"]]
    assert calls[0] == "move"
    assert calls[1:5] == ["grasp", "setLoad", "setLoad", "move"]
    grasp = next(call for call in head["calls"] if call["call"] == "grasp")
    assert grasp["width"] == 0.05
    assert grasp["force"] == 35.0
    end_effector = np.reshape(head["F_T_EE"], (4, 4)).T
    assert np.allclose(end_effector, frame(np.array(head["tcp"]["pose"])))
    assert end_effector[2, 3] == pytest.approx(0.105)


@pytest.mark.parametrize(("name", "format"), [("panda", "csv"), ("ur5e", "csv"), ("ur5e", "ros2")])
def test_what_was_written_is_read_again(
    files: dict[tuple[str, str], Path], name: str, format: str
) -> None:
    program = make_program(arm_record(name, 4), get_arm(name))
    again, _ = read_program(files[name, format], name)
    time = np.linspace(0, program.seconds, 1777)
    exact = format == "ros2"
    for one, other, close in zip(
        program.knots.at(time), again.knots.at(time), (1e-8, 1e-4, 0.5), strict=True
    ):
        assert np.allclose(one, other, rtol=0, atol=1e-7 if exact else close)
    assert [s[1:] for s in again.states] == [s[1:] for s in program.states]
    begins = [(a.time, b.time) for a, b in zip(again.states, program.states, strict=True)]
    assert np.abs(np.diff(begins)).max() <= 1.1e-3
    assert again.blocks.objects == program.blocks.objects
    assert np.allclose(again.blocks.end, program.blocks.end, atol=1e-8)


def test_a_packed_table_is_the_same_table(tmp_path: Path) -> None:
    record = arm_record("ur5e", 2, failures=False)
    plain = export_program(record, "csv", tmp_path / "a.csv").file
    packed = export_program(record, "csv", tmp_path / "a.csv.gz").file
    assert gzip.decompress(packed.read_bytes()) == plain.read_bytes()
    assert packed.stat().st_size < plain.stat().st_size / 3
    assert np.array_equal(
        read_program(packed, "ur5e")[0].knots.position,
        read_program(plain, "ur5e")[0].knots.position,
    )


# ---------------------------------------------------------------- URScript

ARITY = {
    "movej": (1, {"a", "v", "t", "r"}),
    "set_tcp": (1, set()),
    "set_payload": (2, set()),
    "set_tool_digital_out": (2, set()),
    "get_tool_digital_in": (1, set()),
    "sleep": (1, set()),
    "force_mode": (5, set()),
    "end_force_mode": (0, set()),
    "textmsg": (2, set()),
    "popup": (1, {"title", "warning", "error", "blocking"}),
    "set_standard_digital_out": (2, set()),
    "get_standard_digital_in": (1, set()),
    "get_tool_analog_in": (1, set()),
    "get_standard_analog_in": (1, set()),
    "norm": (1, set()),
    "pose_trans": (2, set()),
    "pose_inv": (1, set()),
    "get_forward_kin": (1, set()),
    "get_inverse_kin": (2, set()),
    "get_actual_joint_positions": (0, set()),
    "read_port_register": (1, set()),
    "write_port_register": (2, set()),
    "modbus_add_signal": (5, set()),
    "modbus_set_output_register": (3, set()),
}
"""Functions of URScript: arguments in their place, and those by name."""


class UrScript:
    """A parser of the part of URScript that is used: nested blocks, calls, and nothing unknown."""

    TOKEN = re.compile(
        r'\s*(?:("[^"]*")|(p?\[)|([A-Za-z_]\w*)|(-?\d+\.?\d*(?:e-?\d+)?)|([-+*<>=!]=?|[(),\]:]))'
    )

    def __init__(self, text: str) -> None:
        self.functions = dict(ARITY)
        self.calls: list[tuple[str, list[Any], dict[str, Any]]] = []
        self.defined: list[str] = []
        self.top: dict[str, str] = {}
        """Global variables and what they are set to."""
        depth: list[str] = []
        for number, raw in enumerate(text.splitlines(), 1):
            line = raw.partition("#")[0].strip()
            if not line:
                continue
            where = f"line {number}: {raw}"
            word = line.split("(")[0].split()[0]
            if word == "def":
                head = re.fullmatch(r"def (\w+)\(((?:\w+(?:, \w+)*)?)\):", line)
                assert head, where
                names = [name for name in head[2].split(", ") if name]
                self.functions[head[1]] = (len(names), set())
                self.defined.append(head[1])
                depth.append("def")
            elif word in ("if", "while"):
                assert line.endswith(":"), where
                self.expression(line[len(word) : -1], where)
                depth.append(word)
            elif line == "end":
                assert depth, where
                depth.pop()
            elif line == "halt":
                assert depth, where
            elif word == "return":
                assert "def" in depth, where
                self.expression(line[6:], where)
            elif word in ("local", "global") or re.match(r"\w+ = ", line):
                head, value = line.split(" = ", 1)
                if word == "global":
                    self.top[head.removeprefix("global ")] = value
                self.expression(value, where)
            else:
                self.expression(line, where)
        assert not depth, "a block is not closed"

    def expression(self, text: str, where: str) -> Any:
        tokens, at = [], 0
        text = text.strip()
        while at < len(text):
            found = self.TOKEN.match(text, at)
            assert found, f"{where}: {text[at:]}"
            tokens.append(found.group().strip())
            at = found.end()
        self.tokens, self.where = tokens, where
        value = self.value()
        assert not self.tokens, f"{where}: left over {self.tokens}"
        return value

    def value(self) -> Any:
        left = self.term()
        operators = ("<", ">", "<=", ">=", "==", "!=", "+", "-", "*", "and", "or")
        while self.tokens and self.tokens[0] in operators:
            self.tokens.pop(0)
            left = (left, self.term())
        return left

    def term(self) -> Any:
        token = self.tokens.pop(0)
        if token == "not":
            return ("not", self.term())
        if token == "(":
            inner = self.value()
            assert self.tokens.pop(0) == ")", self.where
            return inner
        if token in ("[", "p["):
            items = self.items("]")[0]
            return items
        if token[0] == '"' or token[0].isdigit() or token[0] == "-":
            return token if token[0] == '"' else float(token)
        assert re.fullmatch(r"[A-Za-z_]\w*", token), f"{self.where}: {token}"
        if self.tokens and self.tokens[0] == "(":
            self.tokens.pop(0)
            given, named = self.items(")")
            assert token in self.functions, f"{self.where}: unknown function {token}"
            count, names = self.functions[token]
            assert len(given) == count, f"{self.where}: {len(given)} arguments"
            assert set(named) <= names, f"{self.where}: {set(named) - names}"
            self.calls.append((token, given, named))
            if token == "l2a_at":  # Joint positions of the plan: what a reader is after.
                return given[0]
        elif self.tokens and self.tokens[0] == "[":
            self.tokens.pop(0)
            return (token, self.items("]")[0])
        return token

    def items(self, close: str) -> tuple[list[Any], dict[str, Any]]:
        given, named = [], {}
        while self.tokens[0] != close:
            if len(self.tokens) > 1 and self.tokens[1] == "=":
                name = self.tokens.pop(0)
                self.tokens.pop(0)
                named[name] = self.value()
            else:
                assert not named, f"{self.where}: an argument after a named one"
                given.append(self.value())
            if self.tokens[0] == ",":
                self.tokens.pop(0)
        self.tokens.pop(0)
        return given, named


def test_the_parser_finds_faults() -> None:
    for bad in (
        "def f():\n  movej([0], 1)\nend",
        "def f():\n  fly(1)\nend",
        "def f():\n  sleep(1)\n",
        "end",
        "def f()\nend",
        "def f():\n  movej([0], x=1)\nend",
        "def f():\n  sleep((1)\nend",
    ):
        with pytest.raises((AssertionError, IndexError)):
            UrScript(bad)


def test_urscript_is_well_formed_and_checks_what_is_held(
    files: dict[tuple[str, str], Path],
) -> None:
    text = files["ur5e", "urscript"].read_text()
    script = UrScript(text)
    assert script.defined[0] == "l2a_build"
    # What controllers ask for: one function, and nothing else in the first column; no call.
    lines = text.splitlines()
    assert text.isascii()
    assert (lines[0], lines[-1]) == ("def l2a_build():", "end")
    assert all(line.startswith("  ") for line in lines[1:-1])
    calls = [name for name, _, _ in script.calls]
    program = make_program(arm_record("ur5e", 4), get_arm("ur5e"))
    reached = [step for step in program.steps if step.checks]
    checks = [given for name, given, _ in script.calls if name == "l2a_check"]
    assert checks == [[s.number, f'"block {s.cells[0]}"'] for s in reached for _ in range(2)]
    closed = False
    for name in calls[calls.index("set_tcp") :]:
        closed = {"l2a_close": True, "l2a_open": False}.get(name, closed)
        assert closed or name != "l2a_check"
    loads = [given[0] for name, given, _ in script.calls if name == "set_payload"]
    # The gripper alone, named at the top, and with a block.
    assert set(loads) == {"l2a_tool_mass", 1.03}
    assert script.top["l2a_tool_mass"] == "0.9300"


def test_urscript_follows_the_path_that_was_checked(
    files: dict[tuple[str, str], Path],
) -> None:
    arm = get_arm("ur5e")
    script = UrScript(files["ur5e", "urscript"].read_text())
    moves = moves_of(script)
    corners = np.array([q for q, _ in moves])
    program = make_program(arm_record("ur5e", 4), arm)
    path = program.knots.at(np.linspace(0, program.seconds, 4001))[0]
    # Every point of the path is near the line between two corners, and every corner on the path.
    start, chord = corners[:-1], np.diff(corners, axis=0)
    length = np.maximum((chord**2).sum(1), 1e-18)
    share = np.clip(((path[:, None] - start) * chord).sum(2) / length, 0, 1)
    off = np.abs(path[:, None] - start - share[..., None] * chord).max(2).min(1)
    assert off.max() <= 2 * ROUND
    near = np.abs(corners[:, None] - program.knots.position).max(2).min(1)
    assert near.max() <= 1e-6
    # Never faster than the arm may be; blends of neighbours do not meet.
    tool = [forward(get_chain(arm), q)[0] for q in corners]
    for k, (_, named) in enumerate(moves):
        assert 0 < named["v"] <= arm.velocity.max()
        assert 0 < named["a"] <= arm.acceleration.max()
        blend = named.get("r", 0.0)
        assert blend <= BLEND
        if blend:
            ways = [np.linalg.norm(tool[k] - tool[k - 1]), np.linalg.norm(tool[k + 1] - tool[k])]
            assert blend + moves[k + 1][1].get("r", 0.0) <= max(ways[1], 1e-9)
            assert blend <= min(ways)


def moves_of(script: UrScript) -> list[tuple[np.ndarray, dict[str, float]]]:
    """Where the arm goes, and how; speeds and accelerations before the factor."""
    found = [
        (np.array(given[1]), {"v": 0.5, "a": 0.5})
        for name, given, _ in script.calls
        if name == "l2a_start"
    ][:1]
    for name, values, named in script.calls:
        if name == "movej" and isinstance(values[0], list):
            assert {named[key][1] for key in "av"} == {"l2a_factor"}
            told = {key: value if key == "r" else value[0] for key, value in named.items()}
            found.append((np.array(values[0]), told))
    return found


def as_controller(script: str, program: Program, arm: Arm) -> Program:
    """What a controller makes of a script, as a program to be played: every line from rest to rest
    on a quintic as fast as the line allows, blends left out, and time for the tool."""
    assert arm.suction is not None
    begin = script.index("  set_tcp")
    time, rows, states, ends = [0.0], [], [program.states[0]], []
    for line in script[begin:].splitlines():
        text = line.strip()
        if text.startswith(("movej", "l2a_start")):
            q = np.array([float(x) for x in text[text.index("[") + 1 : text.index("]")].split(",")])
            if text.startswith("l2a_start"):
                # Where every step begins is where the one before it has ended.
                assert not rows or np.abs(q - rows[-1]).max() <= 1e-5
                rows = rows or [q]
                continue
            a, v = (float(re.search(rf"{key}=([\d.]+)", text)[1]) for key in "av")
            way = np.abs(q - rows[-1]).max()
            time.append(time[-1] + max(1.875 * way / v, math.sqrt(5.774 * way / a), 1e-3))
            rows.append(q)
        elif text.startswith("# step") and time[-1]:
            ends.append(time[-1])
        elif rows and text.startswith(("l2a_close", "l2a_open", "set_payload")):
            change: dict[str, Any] = {"vacuum": text.startswith("l2a_close")}
            if text.startswith("set_payload"):
                alone = "l2a_tool_mass" in text
                mass = 0.0 if alone else float(text[12:].split(",")[0]) - driver_of(arm).tool_mass
                change = {"load": round(mass, 4)}
            states.append(states[-1]._replace(time=time[-1], **change))
            time.append(time[-1] + 0.5)
            rows.append(rows[-1])
    still = np.zeros((len(rows), len(rows[0])))
    steps = [
        step._replace(end=end) for step, end in zip(program.steps, [*ends, time[-1]], strict=True)
    ]
    supply = tuple(one._replace(time=time[-1]) for one in program.blocks.supply)
    return dataclasses.replace(
        program,
        knots=Knots(np.array(time), np.array(rows), still, still),
        states=tuple(states),
        steps=tuple(steps),
        blocks=program.blocks._replace(supply=supply),
    )


def test_urscript_builds_the_same(suction_build: BuildRecord, tmp_path: Path) -> None:
    arm = get_arm("ur5e", "suction")
    script = export_program(suction_build, "urscript", tmp_path).file.read_text()
    found = play(as_controller(script, make_program(suction_build, arm), arm), arm)
    assert found.same, found.fault
    assert found.error.max() <= 1e-3


def test_urscript_waits_for_the_other_arm(suction_build: BuildRecord, tmp_path: Path) -> None:
    """Before it moves on; what is over is said before that, also by steps that are left out."""
    arm = get_arm("ur5e", "suction")
    program = make_program(suction_build, arm)
    (_, end), (begin, _) = list(motions(program))[:2]
    first, second = float(program.knots.time[end]), float(program.knots.time[begin])
    later = program.steps[0].end
    waits = Wait(second, 3.0, 1), Wait(later, 9.0, 2)
    two = dataclasses.replace(program, waits=waits, awaited=(first, later))
    settings = ProgramSettings(other_arm="192.168.0.3")
    write_urscript(two, arm, tmp_path / "two.script", settings)
    text = (tmp_path / "two.script").read_text()
    script = UrScript(text)
    assert script.top["l2a_other_arm"] == '"192.168.0.3"'
    body = text[text.index("  l2a_meet()\n") :]
    words = re.findall(r"l2a_done\(\d\)|l2a_await\(\d\)", body)
    assert words == ["l2a_done(1)", "l2a_await(1)", "l2a_done(2)", "l2a_done(2)", "l2a_await(2)"]
    at = body.index("l2a_await(1)")
    assert body[at:].split("\n")[1].strip().startswith(("movej", "l2a_", "set_payload"))
    alone = export_program(suction_build, "urscript", tmp_path / "alone.script").file.read_text()
    moves = [[line for line in one.splitlines() if "movej" in line] for one in (text, alone)]
    assert moves[0] == moves[1]
    assert "register" not in alone


def test_urscript_of_two_asks_by_hand_when_the_other_arm_has_come_so_far(
    suction_build: BuildRecord, tmp_path: Path
) -> None:
    """It waits, asks, and tells what it asked for; what the other program asks for it mentions."""
    arm = get_arm("ur5e", "suction")
    program = make_program(suction_build, arm)
    later, end = program.steps[0].end, program.seconds
    hands = tuple(
        ByHand(*one)
        for one in (
            (1, (3,), "post", True, later),
            (1, (3,), "wedge", True, later),
            (2, (3,), "post", False, end),
        )
    )
    waits = Wait(later, 3.0, 1), Wait(later + 5.0, 7.0, 2, ("by hand: place prop",))
    waits = *waits, Wait(end, 9.0, 3)
    two = dataclasses.replace(
        program,
        hands=hands,
        halts=(later, later + BY_HAND, end),
        waits=waits,
        awaited=(1.0, later + BY_HAND, later + 2 * BY_HAND, end + BY_HAND),
    )
    write_urscript(two, arm, tmp_path / "two.script")
    text = (tmp_path / "two.script").read_text()
    UrScript(text)
    body = text[text.index("  l2a_meet()\n") :]
    words = re.findall(r"l2a_done\(\d\)|l2a_await\(\d\)|popup\(\"by hand: [a-z ]+|# step \d", body)
    assert words == [
        *("# step 1", "l2a_done(1)", "# step 2", "l2a_done(1)"),
        *("l2a_await(1)", 'popup("by hand: place post', "l2a_done(2)"),
        *('popup("by hand: place wedge', "l2a_done(3)", "l2a_await(2)"),
        *("l2a_await(3)", 'popup("by hand: take away post', "l2a_done(4)"),
    ]
    assert "# by hand: place prop: the other program asks for it\n" in body
    assert "  by hand: place prop, before step 2 goes on: the other program asks for it" in text


def payloads(script: str) -> list[tuple[float, list[float]]]:
    """Mass [kg] and centre of mass [m] of every line, those of the tool alone from the top."""
    top = UrScript(script).top
    mass, centre = float(top["l2a_tool_mass"]), json.loads(top["l2a_tool_centre"])
    found = []
    for name, values, _ in UrScript(script).calls:
        if name == "set_payload":
            alone = values[0] == "l2a_tool_mass"
            found.append((mass, centre) if alone else (values[0], values[1]))
    return found


def test_the_payload_is_that_of_tool_and_block(suction_build: BuildRecord, tmp_path: Path) -> None:
    """A brick of 0.2 kg hangs with its middle 25 mm below a cup 120 mm from the flange."""
    script = export_program(suction_build, "urscript", tmp_path).file.read_text()
    told = payloads(script)
    assert [round(mass, 4) for mass, _ in told] == [0.35, 0.55, 0.35, 0.55, 0.35]
    tool = [0.0, 0.0, 0.4 * 0.12]
    for mass, centre in told:
        both = [0.0, 0.0, (0.35 * 0.048 + 0.2 * 0.145) / 0.55]
        wanted = tool if mass == 0.35 else both
        assert centre == pytest.approx(wanted, abs=1.5e-3)
    # Taken beside its middle, a block is beside the axis of the flange.
    arm = get_arm("ur5e", "suction")
    program = make_program(suction_build, arm)
    middle = held_centre(program, arm, program.steps[0], 0)
    start = program.blocks.start.copy()
    start[program.steps[0].cells[0], 0] += 0.03
    moved = dataclasses.replace(program, blocks=program.blocks._replace(start=start))
    beside = held_centre(moved, arm, program.steps[0], 0)
    assert np.linalg.norm(beside[:2] - middle[:2]) == pytest.approx(0.03, abs=1e-6)
    assert beside[2] == pytest.approx(middle[2], abs=1e-3)


def test_what_a_layout_says_stands_at_the_top_of_the_program(tmp_path: Path) -> None:
    shift = np.array([0.01, -0.02, 0.003, 0, 0, 0.01])
    frame = planned_frame(get_arm("ur5e")) + shift
    layout = tmp_path / "cell.json"
    section = {
        "speed_factor": 0.25,
        "dwell": 0.3,
        "start_tolerance": 0.02,
        "output": {"bank": "standard", "number": 5, "on": False},
        "input": {"bank": "standard", "number": 1, "held": False, "threshold": 2.5},
        "base_frame": frame.tolist(),
    }
    head = {"format": "learn2assemble-layout", "version": 2}
    layout.write_text(json.dumps({**head, "program": section}))
    record = arm_record("ur5e", 4, failures=False)
    done = export_program(record, "urscript", tmp_path, layout=layout, resume_from=3)
    text = done.file.read_text()
    script = UrScript(text)
    told = {
        "l2a_factor": "0.25",
        "l2a_resume_from": "3",
        "l2a_output": "5",
        "l2a_output_on": "False",
        "l2a_input": "1",
        "l2a_input_held": "False",
        "l2a_threshold": "2.5",
        "l2a_dwell": "0.3",
        "l2a_start_tolerance": "0.02",
        "l2a_first_step": "1",
        "l2a_last_step": str(len(record.steps)),
    }
    assert told.items() <= script.top.items()
    assert json.loads(script.top["l2a_frame"][1:]) == pytest.approx(frame.tolist(), abs=1e-6)
    # They stand before anything else, and everything that depends on them names them.
    assert max(text.index(f"global {name}") for name in told) < text.index("  def ")
    for call in (
        "set_standard_digital_out(l2a_output, l2a_output_on)",
        "sleep(l2a_dwell)",
        "get_standard_analog_in(l2a_input)",
    ):
        assert call in text
    # Each step is left out as a whole, and begins with a check of where the arm is.
    parts = text.split("  # step ")[1:]
    plain = export_program(record, "urscript", tmp_path / "plain.script").file.read_text()
    program = make_program(record, get_arm("ur5e"))
    begins = [0.0, *(step.end for step in program.steps[:-1])]
    for number, (part, begin) in enumerate(zip(parts, begins, strict=True), 1):
        lines = [line.strip() for line in part.splitlines()]
        assert lines[1] == f"if (l2a_resume_from <= {number}):"
        q = program.knots.at(np.array([begin]))[0][0]
        given = json.loads(lines[2][lines[2].index("[") : lines[2].index("]") + 1])
        assert lines[2].startswith(f"l2a_start({number}, ")
        assert given == pytest.approx(q.tolist(), abs=1e-6)
        assert lines[-1 if number < len(begins) else -2] == "end"
    assert text.split("  # step ")[1:] == plain.split("  # step ")[1:]
    site = read_site(layout)
    assert site.program.output == ToolOutput("standard", 5, False)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"speed_factor": 0}, "program.speed_factor: got 0"),
        ({"speed_factor": 1.01}, "speed_factor"),
        ({"other_arm": "http://x"}, "other_arm: got 'http"),
        ({"dwell": -1}, "0 to 10"),
        ({"output": {"number": 2}}, "output.number"),
        ({"output": {"bank": "tol"}}, "'tool'"),
        ({"input": {"threshold": 11}}, "threshold"),
        ({"output": {"on": 1}}, "true or false"),
        ({"input": {"threshold": 1, "bank": "standard", "number": 2}}, "0 to 1"),
        ({"base_frame": [0, 0, 0]}, "base_frame"),
        ({"base_frame": [5, 0, 0, 0, 0, 0]}, "within"),
        ({"sped": 1}, "'speed_factor'"),
        ([], "JSON object"),
    ],
)
def test_settings_of_programs_that_are_wrong_are_refused(
    section: Any, words: str, tmp_path: Path
) -> None:
    layout = tmp_path / "cell.json"
    head = {"format": "learn2assemble-layout", "version": 2}
    layout.write_text(json.dumps({**head, "program": section}))
    with pytest.raises(InputError, match=re.escape(words)):
        export_program(arm_record("ur5e", 2), "urscript", tmp_path / "new", layout=layout)
    assert not (tmp_path / "new").exists()


def test_a_program_resumes_from_a_step_it_has(tmp_path: Path) -> None:
    record = arm_record("ur5e", 2)
    for step in (0, 99, True):
        with pytest.raises(InputError, match="resume_from"):
            export_program(record, "urscript", tmp_path / "new", resume_from=step)
    with pytest.raises(InputError, match="the format urscript"):
        export_program(record, "csv", tmp_path / "new", resume_from=1)


# ---------------------------------------------------------------- ROS 2


def read_bag(file: Path) -> Any:
    """A bag, by a library that is none of the product."""
    return pytest.importorskip("rosbags.highlevel").AnyReader([file])


def test_message_definitions_are_those_of_ros(files: dict[tuple[str, str], Path]) -> None:
    types = pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS2_HUMBLE)
    with read_bag(files["panda", "ros2"]) as bag:
        own = bag.typestore.fielddefs
        checked = 0
        for name, (_, fields) in own.items():
            if name in store.fielddefs:
                assert fields == store.fielddefs[name][1], name
                checked += 1
    assert checked >= 15


@pytest.mark.parametrize("name", ARMS)
def test_a_bag_is_read_without_ros(files: dict[tuple[str, str], Path], name: str) -> None:
    arm = get_arm(name)
    program = make_program(arm_record(name, 4), arm)
    found: dict[str, list[tuple[float, Any]]] = {}
    with read_bag(files[name, "ros2"]) as bag:
        for connection, time, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time / 1e9, message))
    joints = list(driver_of(arm).joints)
    points = 0
    for begin, message in found["/joint_trajectory"]:
        assert message.joint_names == joints
        for point in message.points:
            time = begin + point.time_from_start.sec + point.time_from_start.nanosec * 1e-9
            told = (point.positions, point.velocities, point.accelerations)
            for one, other in zip(told, program.knots.at(np.array([time])), strict=True):
                assert np.allclose(one, other[0], atol=1e-5)
            points += 1
        for end in (message.points[0], message.points[-1]):
            assert np.abs(end.velocities).max() <= 1e-5
    assert points > 100
    for time, message in found["/joint_states"][::50]:
        assert message.name == joints
        assert np.allclose(message.position, program.knots.at(np.array([time]))[0][0], atol=1e-9)
    grips = [(m.position, m.max_effort) for _, m in found["/gripper/command"]]
    assert set(grips) == {(OPENING, 0.0), (0.05, arm.gripper.force)}
    assert len(found["/blocks"][0][1].markers) == len(program.blocks.start)
    assert len({(m.color.r, m.color.g, m.color.b) for m in found["/blocks"][0][1].markers}) == 4
    # Tool point and blocks are where kinematics and record say.
    last: dict[str, np.ndarray] = {}
    for time, message in found["/tf"]:
        for one in message.transforms:
            p, r = one.transform.translation, one.transform.rotation
            last[one.child_frame_id] = np.array([p.x, p.y, p.z, r.w, r.x, r.y, r.z])
        q = program.knots.at(np.array([time]))[0][0]
        assert np.allclose(last["tcp"][:3], forward(get_chain(arm), q)[0], atol=1e-6)
        assert np.allclose(frame(last["tcp"])[:3, :3], forward(get_chain(arm), q)[1], atol=1e-6)
    for cell_number, pose in enumerate(program.blocks.end):
        assert np.allclose(last[f"cell_{cell_number}"], pose, atol=1e-9)
    step = next(step for step in program.steps if step.held and step.checks)
    held = [
        np.array([t.transform.translation.x, t.transform.translation.y, t.transform.translation.z])
        - forward(get_chain(arm), program.knots.at(np.array([time]))[0][0])[0]
        for time, message in found["/tf"]
        for t in message.transforms
        if t.child_frame_id == f"cell_{step.cells[0]}"
        and step.held is not None
        and step.held[0] + 0.05 < time < step.held[1] - 0.05
    ]
    assert len(held) > 20
    assert np.ptp(np.linalg.norm(held, axis=1)) < 1e-6
    flanges = {t.child_frame_id: t for _, m in found["/tf_static"] for t in m.transforms}
    assert set(flanges) == {driver_of(arm).base_frame, driver_of(arm).flange_frame}


def test_without_the_extra_a_bag_says_which(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, files: dict[tuple[str, str], Path]
) -> None:
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    record = arm_record("panda", 2, failures=False)
    with pytest.raises(MissingExtraError, match=r"learn2assemble\[ros2\]"):
        export_program(record, "ros2", tmp_path)
    with pytest.raises(MissingExtraError, match=r"learn2assemble\[ros2\]"):
        read_program(files["panda", "ros2"], "panda")
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- bad input


def cut(text: str) -> str:
    return text[: len(text) * 2 // 3]


def whole_lines(text: str) -> str:
    return "\n".join(text.splitlines()[:-300]) + "\n"


def cell_of(line: int, column: str, value: str) -> Callable[[str], str]:
    """Change one number of a table."""

    def change(text: str) -> str:
        lines = text.splitlines()
        first = next(k for k, one in enumerate(lines) if not one.startswith("#"))
        row = lines[first + line].split(",")
        row[lines[first].split(",").index(column)] = value
        lines[first + line] = ",".join(row)
        return "\n".join(lines) + "\n"

    return change


FAULTS: dict[str, tuple[Callable[[str], str], str]] = {
    "cut": (cut, "lines of|not complete"),
    "lines missing": (whole_lines, "not complete"),
    "empty": (lambda text: "", "empty"),
    "no table": (lambda text: "a,b\n1,2\n", "header"),
    "no limits": (lambda t: re.sub("# limits:.*\n", "", t), "limits"),
    "limits of nothing": (lambda t: re.sub("# limits:.*\n", "# limits: {}\n", t), "limits"),
    "a limit of 0": (
        lambda t: t.replace('"jerk": [500.0', '"jerk": [0.0').replace(
            '"jerk": [7500.0', '"jerk": [0.0'
        ),
        "limits.jerk",
    ),
    "no rate": (lambda t: re.sub("# rate:.*\n", "", t), "rate"),
    **{
        f"rate {rate}": (lambda t, rate=rate: re.sub("# rate:.*\n", f"# rate: {rate}\n", t), "rate")
        for rate in ("1e9", "0", "-1000", "NaN", "true", '"fast"')
    },
    "header without blocks": (lambda t: re.sub("# blocks:.*\n", "", t), "blocks"),
    "nan": (cell_of(40, "q_elbow_joint", "nan"), "got nan, expected a finite number"),
    "word": (cell_of(40, "q_elbow_joint", "fast"), "numbers"),
    "time back": (cell_of(40, "time", "0.001"), "time"),
    "time twice": (cell_of(40, "time", "0.038"), "time"),
    "beyond": (cell_of(40, "q_elbow_joint", "3.3"), "elbow_joint.*position 3.3"),
    "jump": (cell_of(40, "q_elbow_joint", "1.8"), "elbow_joint.*velocity"),
    "too fast": (cell_of(40, "dq_elbow_joint", "3.5"), "elbow_joint.*velocity 3.5"),
    "jerk": (cell_of(40, "ddq_elbow_joint", "3.0"), "elbow_joint.*jerk"),
    "column": (lambda t: t.replace("q_elbow_joint", "q_knee", 1), "columns"),
    "other joints": (lambda t: t.replace('"elbow_joint"', '"knee"', 1), "joints"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_damaged_table_is_refused_in_one_line(
    fault: str,
    files: dict[tuple[str, str], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    damage, words = FAULTS[fault]
    file = tmp_path / "bad.csv"
    file.write_text(damage(files["ur5e", "csv"].read_text()))
    assert main(["replay-trajectory", str(file), "--arm", "ur5e"]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert re.search(words, line), line
    assert "bad.csv" in line


@pytest.mark.parametrize(("format", "suffix"), [("csv", "csv"), ("ros2", "mcap")])
def test_the_program_of_another_arm_is_refused(
    files: dict[tuple[str, str], Path], format: str, suffix: str
) -> None:
    with pytest.raises(InputError, match=r"expected those of panda: panda_joint1"):
        read_program(files["ur5e", format], "panda")


def test_a_bag_is_known_by_its_content(files: dict[tuple[str, str], Path], tmp_path: Path) -> None:
    file = tmp_path / "program.bag"
    file.write_bytes(files["ur5e", "ros2"].read_bytes())
    assert read_program(file, "ur5e")[1].name == "ur5e"


@pytest.mark.parametrize("keep", [0, 100, 0.3, 0.999])
def test_a_damaged_bag_is_refused(
    keep: float, files: dict[tuple[str, str], Path], tmp_path: Path
) -> None:
    content = files["ur5e", "ros2"].read_bytes()
    file = tmp_path / "bad.mcap"
    file.write_bytes(content[: int(keep if keep > 1 else keep * len(content))])
    with pytest.raises(InputError, match=r"bad\.mcap"):
        read_program(file, "ur5e")
    file.write_bytes(b"\x00" * 500)
    with pytest.raises(InputError, match=r"bad\.mcap"):
        read_program(file, "ur5e")


@pytest.mark.parametrize("format", PROGRAM_FORMATS)
def test_what_cannot_be_exported_is_refused(format: str, tmp_path: Path) -> None:
    arm = "panda" if format == "urscript" else "ur5e"
    if format in ("franka", "urscript"):
        with pytest.raises(InputError, match=f"{format} for {arm}"):
            export_program(arm_record(arm, 2, failures=False), format, tmp_path)
    with pytest.raises(InputError, match="folder of a build with an arm"):
        export_program(tmp_path / "none", format, tmp_path)
    still = dataclasses.replace(arm_record(arm, 2, failures=False), steps=())
    with pytest.raises(InputError, match="a build with motions"):
        export_program(still, format, tmp_path)
    assert not list(tmp_path.iterdir())


def test_names_of_formats_are_known_before_libraries_load(tmp_path: Path) -> None:
    assert set(PROGRAM_FORMATS) == set(PROGRAMS)
    with pytest.raises(UnknownNameError, match="did you mean 'urscript'"):
        export_program(tmp_path, "urscrpt", tmp_path)
    assert main(["export", str(tmp_path), "--format", "urscrpt"]) == 2


@pytest.mark.parametrize("format", ["csv", "ros2"])
def test_an_old_file_stays_where_writing_fails(
    format: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = tmp_path / PROGRAMS[format][0]
    old.write_text("old")

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match="No space left"):
        export_program(arm_record("panda", 2, failures=False), format, tmp_path, overwrite=True)
    assert old.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == [old.name]


# ---------------------------------------------------------------- dry run


def built(arm: Arm, state: Scene, targets: list[np.ndarray], hand: Attitude) -> BuildRecord:
    """Waiting blocks, one cell each, put to targets as it was simulated."""
    robot, width = DynamicCell(arm), 0.0 if arm.suction else OPENING
    cells = len(state.position)
    log = BuildRecorder(
        arm,
        arm.home,
        width,
        upright(state.position, state.yaw),
        [[k] for k in range(cells)],
        "MuJoCo",
        CellShapes(state.half),
    )
    numbers, joints, turns = np.arange(cells), None, None
    for target in targets:
        move = Move(state.num_placed, target, hand, hand)
        done = robot.attempt(state, move, joints=joints, quaternion=turns)
        assert done.reached, done.detail
        numbers = log.add_attempt(done, state, move, numbers)
        assert done.after is not None
        state, joints, turns = done.after, done.joints, done.quaternion
    return log.record()


@pytest.fixture(scope="module")
def small_build() -> BuildRecord:
    """Two blocks put beside and on a third by the Panda."""
    state = scene([(0, 0, 0)], [(3, -3, 0), (3, 3, 0)])
    return built(get_arm("panda"), state, [cell(1, 0, 0), cell(0, 0, 1)], Attitude())


BRICK = np.array([0.05, 0.025, 0.025])


@pytest.fixture(scope="module")
def suction_build() -> BuildRecord:
    """Two bricks put beside and across a third by the UR5e with its cup; a third one waits in a
    magazine, and is presented at the end."""
    arm = get_arm("ur5e", "suction")
    position = np.array([[0, 0, 0.025], [0.1, -0.25, 0.025], [-0.1, -0.25, 0.025]])
    state = Scene(position, np.zeros(3), np.arange(3), 1, np.tile(BRICK, (3, 1)))
    targets = [np.array([0.1005, 0, 0.025]), np.array([0.05, 0, 0.075])]
    record = built(arm, state, targets, Attitude(depth=0.025))
    steps, hidden = [], np.array([[0.2, -0.25, -0.1, 1.0, 0, 0, 0]])
    shown = np.array([[0.2, -0.25, 0.025, 1.0, 0, 0, 0]])
    for step in record.steps:
        last = step is record.steps[-1]
        steps.append(
            dataclasses.replace(
                step,
                before=np.vstack([step.before, hidden]),
                after=np.vstack([step.after, shown if last else hidden]),
            )
        )
    assert record.half is not None
    return dataclasses.replace(
        record,
        steps=tuple(steps),
        objects=(*record.objects, (3,)),
        half=np.vstack([record.half, BRICK]),
    )


def test_a_block_alone_is_lifted_to_the_end_of_its_way_without_jumps() -> None:
    """The way up is hardly longer than the slot the block slides out of slowly."""
    state = Scene(
        np.array([[-0.12, 0.0, 0.025]]), np.zeros(1), np.arange(1), 0, np.full((1, 3), 0.025)
    )
    arm = get_arm("panda", "suction")
    record = built(arm, state, [np.array([0.0, 0.1, 0.025])], Attitude(depth=0.025))
    assert find_fault(record) is None


@pytest.mark.parametrize("format", ["csv", "franka", "ros2"])
def test_an_exported_program_builds_the_same(
    small_build: BuildRecord, format: str, tmp_path: Path
) -> None:
    write_record(small_build, tmp_path / "trajectory.json")
    done = export_program(tmp_path, format, tmp_path)
    assert max(done.used.values()) <= 1
    found = replay_program(done.file, "panda")
    assert found.same
    assert found.error.max() <= 1e-3


@pytest.mark.parametrize("format", ["csv", "ros2"])
def test_a_program_with_suction_builds_the_same(
    suction_build: BuildRecord, format: str, tmp_path: Path
) -> None:
    write_record(suction_build, tmp_path / "trajectory.json")
    done = export_program(tmp_path, format, tmp_path)
    program, arm = read_program(done.file, "ur5e")
    assert arm.suction is not None
    assert [one.cells for one in program.blocks.supply] == [(3,)]
    changes = [state.vacuum for state in program.states]
    assert [on for on, _ in itertools.groupby(changes)] == [False, True, False, True, False]
    # Known to the controller while it hangs, as heavy as a brick of two cubes.
    loads = {round(state.load, 9) for state in program.states if state.vacuum}
    assert loads == {0.0, 0.2}
    for before, state in itertools.pairwise(program.states):
        if state.vacuum != before.vacuum:
            wait = arm.suction.grip_time if state.vacuum else arm.suction.release_time
            span = np.linspace(state.time + 1e-6, state.time + wait - 2e-3, 9)
            assert not program.motion[program.knots.pieces(span)].any()
    found = replay_program(done.file, "ur5e")
    assert found.same, found.fault
    assert found.error.max() <= 1e-3


def test_an_arm_that_runs_into_something_ends_the_dry_run(
    suction_build: BuildRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A post in the way across, far from what the first step moves, is held still and found."""
    post = np.array([[0.1, -0.12, 0.25, 1.0, 0, 0, 0]])
    steps = [
        dataclasses.replace(
            step, before=np.vstack([step.before, post]), after=np.vstack([step.after, post])
        )
        for step in suction_build.steps
    ]
    assert suction_build.half is not None
    record = dataclasses.replace(
        suction_build,
        steps=tuple(steps),
        objects=(*suction_build.objects, (4,)),
        half=np.vstack([suction_build.half, [0.02, 0.02, 0.25]]),
    )
    file = export_program(record, "ros2", tmp_path).file
    assert main(["replay-trajectory", str(file), "--arm", "ur5e"]) == 1
    assert re.search("step 1: .* touches block 4", capsys.readouterr().out)


def test_suction_in_urscript_and_ros(suction_build: BuildRecord, tmp_path: Path) -> None:
    script = UrScript(export_program(suction_build, "urscript", tmp_path).file.read_text())
    calls = [name for name, _, _ in script.calls]
    body = calls[calls.index("set_tcp") :]
    assert body.count("l2a_close") == 2
    assert body.count("l2a_open") == 2
    lengths = [given[0][2] for name, given, _ in script.calls if name == "set_tcp"]
    assert lengths == [0.12]
    with read_bag(export_program(suction_build, "ros2", tmp_path).file) as bag:
        topics = {connection.topic for connection in bag.connections}
        assert "/suction/vacuum" in topics
        assert "/gripper/command" not in topics
        connections = [c for c in bag.connections if c.topic == "/blocks"]
        (_, _, raw), *_ = bag.messages(connections)
        marker = bag.deserialize(raw, connections[0].msgtype).markers[0]
        assert (marker.scale.x, marker.scale.y) == (0.1, 0.05)


def test_a_program_that_builds_something_else_is_told_so(
    small_build: BuildRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    last = small_build.steps[-1]
    after = last.after.copy()
    after[1, 0] += 0.005
    wrong = (*small_build.steps[:-1], dataclasses.replace(last, after=after))
    record = dataclasses.replace(small_build, steps=wrong)
    file = export_program(record, "ros2", tmp_path).file
    assert main(["replay-trajectory", str(file), "--arm", "panda", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["same"] is False
    assert told["worst_block"] == 1
    assert told["worst_error_m"] == pytest.approx(0.005, abs=1e-3)


def test_driver_names_are_in_no_model() -> None:
    """The names of the drivers are not those of the models, so a mix-up would show."""
    for name in ARMS:
        model = arm_model(get_arm(name))
        joints = {model.joint(k).name for k in range(model.njnt)}
        assert not joints & set(driver_of(get_arm(name)).joints)


def test_the_table_is_small_text(files: dict[tuple[str, str], Path]) -> None:
    _, rows = table(files["ur5e", "csv"])
    buffer = io.StringIO()
    csv.writer(buffer).writerow(rows[0].values())
    assert len(buffer.getvalue()) < 400
