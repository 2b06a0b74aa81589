"""Programs as ROS 2 bags (MCAP), without ROS.

A motion is a ``JointTrajectory`` of its knots, between which the controllers of ROS 2 follow the
same quintic; a bag therefore holds the program exactly. Messages are those of ROS 2 Humble and
later; their topics are listed in ``docs/robot_programs.md``.
"""

from __future__ import annotations

import colorsys
import io
import struct
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, extra
from learn2assemble.export import asset
from learn2assemble.export.robot_tables import (
    MOST_BYTES,
    changes,
    header,
    read_header,
    to_json,
)
from learn2assemble.files import read_bytes, write_file
from learn2assemble.geometry.hulls import Hull
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
    rotate_vectors,
)
from learn2assemble.kinematics.chain import forward_many, get_chain
from learn2assemble.motion.driver import driver_of
from learn2assemble.motion.knots import Knots, usage
from learn2assemble.motion.program import Program, ToolState, motions
from learn2assemble.motion.waits import on_one_clock
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.moves import STAGES
from learn2assemble.values import load_json

STATE_RATE = 50.0
"""Joint states and transforms per second."""

_TOPICS = {
    "/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/gripper/command": "control_msgs/msg/GripperCommand",
    "/suction/vacuum": "std_msgs/msg/Bool",
    "/tool/load": "std_msgs/msg/Float64",
    "/tool/press": "std_msgs/msg/Float64",
    "/stage": "std_msgs/msg/String",
    "/check": "std_msgs/msg/String",
    "/program": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/blocks": "visualization_msgs/msg/MarkerArray",
}

_OF_ALL = ("/tf", "/tf_static", "/blocks")
"""Topics that two arms share."""


def names_of_two(one: str, other: str) -> tuple[str, str]:
    """What two arms are called in a bag of both."""
    return (one, other) if one != other else (f"{one}_1", f"{other}_2")


def _definitions() -> dict[str, str]:
    """The types of all topics, each followed by those it contains (ROS 2 Humble and later)."""
    rule = "=" * 80 + "\n"
    parts = asset("ros2.msg").split(rule)[1:]
    told = dict(part.removeprefix("MSG: ").strip().split("\n", 1) for part in parts)

    def contained(kind: str, found: list[str]) -> list[str]:
        for line in told[kind].splitlines():
            part = line.split()[0].partition("[")[0]
            if part in told and part not in found:
                found.append(part)
                contained(part, found)
        return found

    return {
        kind: f"\n{rule}".join(
            [told[kind], *(f"MSG: {part}\n{told[part]}" for part in contained(kind, []))]
        )
        for kind in _TOPICS.values()
    }


def write_bag(
    program: Program, arm: Arm, path: Path, across: tuple[Program, Arm] | None = None
) -> None:
    """Write a bag; time 0 is the beginning of the program.

    Args:
        across: of a build by two arms, the other one: the bag has both then, on one clock, with the
            name of its arm before each topic and frame.

    Raises:
        MissingExtraError: without the extra ``ros2``.
        InputError: where it cannot be written.
    """
    with extra("mcap-ros2-support", "ros2"):
        from mcap_ros2.writer import Writer
    out = io.BytesIO()
    writer = Writer(out)
    schemas = {kind: writer.register_msgdef(kind, text) for kind, text in _definitions().items()}
    both = [("", program, arm)]
    if across is not None:
        first, second = on_one_clock((program, across[0]))
        one, two = names_of_two(program.arm, across[0].arm)
        both = [(f"/{one}", first, arm), (f"/{two}", second, across[1])]
    messages = [
        (time, prefix * (topic not in _OF_ALL) + topic, topic, message)
        for prefix, told, by in both
        for time, topic, message in (
            *_head_messages(told, by),
            *_motion_messages(told, by),
            *_tool_messages(told),
            *_scene_messages(told, by, prefix[1:]),
        )
    ]
    for time, topic, kind, message in sorted(messages, key=itemgetter(0)):
        writer.write_message(topic, schemas[_TOPICS[kind]], message, time, time)
    writer.finish()
    write_file(path, out.getvalue(), "bag")


Message = tuple[int, str, dict[str, Any]]
"""Time [ns], topic, content."""


def _head_messages(program: Program, arm: Arm) -> Iterator[Message]:
    yield 0, "/program", {"data": to_json(header(program, arm))}
    pairs = np.column_stack([program.step, program.stage])
    blocks = {step.number: program.blocks.name(step.cells[0]) for step in program.steps}
    for k in np.flatnonzero(np.any(np.diff(pairs, axis=0, prepend=-1), axis=1)).tolist():
        told: list[int] = pairs[k].tolist()
        number, stage = told
        words = f"step {number}, {blocks.get(number, 'no block')}: "
        words += STAGES[stage] if stage >= 0 else "rest"
        yield _ns(program.knots.time[k]), "/stage", {"data": words}
    for hand, time in program.asks if program.halts else ():
        yield _ns(time), "/stage", {"data": hand.words}
    for step in program.steps:
        for time in step.checks:
            yield _ns(time), "/check", {"data": program.blocks.name(step.cells[0])}


def _motion_messages(program: Program, arm: Arm) -> Iterator[Message]:
    names, knots = list(driver_of(arm).joints), program.knots
    for begin, end in motions(program):
        start = _ns(knots.time[begin])
        rows = zip(*(part[begin : end + 1].tolist() for part in knots), strict=True)
        points = [
            {
                "positions": q,
                "velocities": v,
                "accelerations": a,
                "time_from_start": _stamp(_ns(time) - start),
            }
            for time, q, v, a in rows
        ]
        message = {"header": _header(start, "world"), "joint_names": names, "points": points}
        yield start, "/joint_trajectory", message
    time = _grid(program)
    for t, q, v in zip(time.tolist(), *(part.tolist() for part in knots.at(time)[:2]), strict=True):
        state = {"header": _header(_ns(t), ""), "name": names, "position": q, "velocity": v}
        yield _ns(t), "/joint_states", state


def _tool_messages(program: Program) -> Iterator[Message]:
    for state, new in changes(program):
        time = _ns(state.time)
        if program.suction and "vacuum" in new:
            yield time, "/suction/vacuum", {"data": state.vacuum}
        if not program.suction and new & {"width", "force"}:
            yield time, "/gripper/command", {"position": state.width, "max_effort": state.force}
        if "load" in new:
            yield time, "/tool/load", {"data": state.load}
        if program.blocks.studs is not None and "press" in new:
            yield time, "/tool/press", {"data": state.press}


def _scene_messages(program: Program, arm: Arm, name: str = "") -> Iterator[Message]:
    """Frames of robot, tool point and cells, and the markers in these.

    Args:
        name: of one of two arms, before the frames of its own.
    """
    driver, blocks, own = driver_of(arm), program.blocks, f"{name}/" if name else ""
    # The flange is where the tool point, which moves, says it is.
    turn = driver.tcp[3:] * [1, -1, -1, -1]
    flange = np.concatenate([-rotate_vectors(turn[None], driver.tcp[None, :3])[0], turn])
    fixed = [
        _transform(0, "world", own + driver.base_frame, driver.base),
        _transform(0, f"{own}tcp", own + driver.flange_frame, flange),
    ]
    yield 0, "/tf_static", {"transforms": fixed}
    markers = list[dict[str, Any]]()
    for number, cells in enumerate(blocks.objects):
        colour = colorsys.hsv_to_rgb(number * 0.381966 % 1, 0.55, 0.85)
        for cell in cells:
            hull = None if blocks.hull is None else blocks.hull[cell]
            markers.append(_marker(cell, 2 * blocks.halves[cell], colour, hull))
    yield 0, "/blocks", {"markers": markers}
    time = _grid(program)
    joints = np.ascontiguousarray(program.knots.at(time)[0])
    tools = zip(*forward_many(get_chain(arm), joints), strict=True)
    poses, now, held = blocks.start, 0, dict[int, np.ndarray]()
    for t, (position, rotation) in zip(time.tolist(), tools, strict=True):
        tool = np.concatenate([position, matrix_quaternion(rotation)])
        changed = set[int]() if t else set(range(len(poses)))
        while now < len(program.steps) and t >= program.steps[now].end - 1e-9:
            after = program.steps[now].after
            after = poses if after is None else after
            changed |= set(np.flatnonzero(np.any(poses != after, axis=1)).tolist())
            poses, now, held = after, now + 1, {}
        if now < len(program.steps) and (span := program.steps[now].held) is not None:
            if not held and span[0] <= t <= span[1]:
                held = {cell: _relative(tool, poses[cell]) for cell in program.steps[now].cells}
            if held and t <= span[1]:
                poses = poses.copy()
                for cell, offset in held.items():
                    poses[cell] = _product(tool, offset)
                changed |= set(held)
        transforms = [_transform(_ns(t), "world", f"{own}tcp", tool)]
        transforms += [_transform(_ns(t), "world", f"cell_{c}", poses[c]) for c in sorted(changed)]
        yield _ns(t), "/tf", {"transforms": transforms}


def _grid(program: Program) -> np.ndarray:
    count = int(np.ceil(program.seconds * STATE_RATE - 1e-6))
    return np.minimum(np.arange(count + 1) / STATE_RATE, program.seconds)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    moved = a[:3] + rotate_vectors(a[None, 3:], b[None, :3])[0]
    return np.concatenate([moved, quaternion_product(a[3:], b[3:])])


def _relative(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The pose b as it is seen from the frame a."""
    inverse = a[3:] * [1, -1, -1, -1]
    return np.concatenate(
        [quaternion_matrix(a[3:]).T @ (b[:3] - a[:3]), quaternion_product(inverse, b[3:])]
    )


def _ns(time: float) -> int:
    return round(time * 1e9)


def _stamp(time: int) -> dict[str, int]:
    return {"sec": time // 10**9, "nanosec": time % 10**9}


def _header(time: int, frame: str) -> dict[str, Any]:
    return {"stamp": _stamp(time), "frame_id": frame}


def _transform(time: int, parent: str, child: str, pose: np.ndarray) -> dict[str, Any]:
    x, y, z, *turn = (float(value) for value in pose)
    return {
        "header": _header(time, parent),
        "child_frame_id": child,
        "transform": {
            "translation": {"x": x, "y": y, "z": z},
            "rotation": dict(zip("wxyz", turn, strict=True)),
        },
    }


def _marker(
    cell: int, size: np.ndarray, colour: tuple[float, float, float], hull: Hull | None
) -> dict[str, Any]:
    """A cube, or the triangles of a hull, in the frame of its cell; what is not told is 0 or
    empty."""
    solid: dict[str, Any] = {"type": 1, "scale": dict(zip("xyz", size.tolist(), strict=True))}
    if hull is not None:
        corners = hull.triangles().reshape(-1, 3).tolist()
        points = [dict(zip("xyz", corner, strict=True)) for corner in corners]
        solid = {"type": 11, "scale": {"x": 1.0, "y": 1.0, "z": 1.0}, "points": points}
    return {
        "header": {"frame_id": f"cell_{cell}"},
        "ns": "blocks",
        "id": cell,
        "pose": {"orientation": {"w": 1.0}},
        "color": {**dict(zip("rgb", colour, strict=True)), "a": 1.0},
        "frame_locked": True,
        **solid,
    }


_DAMAGE = (ValueError, TypeError, LookupError, AttributeError, OverflowError, MemoryError)
"""What a reader of bags raises where bytes are not what they should be, besides errors of its
own."""


def is_bag(path: Path) -> bool:
    """Whether a file is a bag, by its name or, whatever its name, by how it begins."""
    if path.suffix == ".mcap" or not path.is_file():
        return path.suffix == ".mcap"
    with path.open("rb") as file:
        return file.read(5) == b"\x89MCAP"


def read_bag(path: Path, name: str) -> tuple[Program, Arm]:
    """Read what :func:`write_bag` has written.

    Raises:
        InputError: see :func:`.robot_programs.read_program`.
        MissingExtraError: without the extra ``ros2``.
    """
    with extra("mcap-ros2-support", "ros2"):
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
        from zstandard import ZstdError
    content, source = read_bytes(path, "bag", MOST_BYTES)
    wanted = ["/program", "/joint_trajectory", "/gripper/command", "/suction/vacuum"]
    wanted += ["/tool/load", "/tool/press"]
    found: dict[str, list[tuple[float, Any]]] = {topic: [] for topic in wanted}
    try:
        reader = make_reader(io.BytesIO(content), True, [DecoderFactory()])  # checks sums
        for _, channel, entry, message in reader.iter_decoded_messages(topics=wanted):
            found[channel.topic].append((entry.log_time / 1e9, message))
    except (McapError, ZstdError, struct.error, EOFError, *_DAMAGE) as error:
        got = str(error) or type(error).__name__
        raise InputError(source, got, "a bag that is whole") from None
    if not found["/program"] or not found["/joint_trajectory"]:
        got = "the programs of two arms" if b"/joint_trajectory" in content else "no program in it"
        raise InputError(source, got, "a bag that l2a export has written, of one arm")
    head = load_json(found["/program"][0][1].data, f"{source}: /program", "header")
    told = read_header(head, source, name)
    arm = told.arm
    knots, motion = _knots_from(found["/joint_trajectory"], told.seconds, arm, source)
    none = np.zeros(len(motion), np.int64)
    program = Program(
        name,
        arm.tool_name,
        arm.suction is not None,
        knots,
        none.astype(np.int8) - 1,
        none,
        motion,
        _states_from(found, told.speed),
        told.steps,
        told.blocks,
        told.stretch,
        waits=told.waits,
        awaited=told.awaited,
    )
    return program, arm


def _knots_from(
    messages: list[tuple[float, Any]], seconds: float, arm: Arm, source: str
) -> tuple[Knots, np.ndarray]:
    """All motions in a row, with rest between them, within the limits of the arm."""
    rows, motion = list[list[float]](), list[int]()
    for number, (_, message) in enumerate(messages, 1):
        if tuple(message.joint_names) != driver_of(arm).joints:
            raise InputError(f"{source}: joints", list(message.joint_names), arm.name)
        begin = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        for k, point in enumerate(message.points):
            since = point.time_from_start.sec + point.time_from_start.nanosec * 1e-9
            row = [begin + since, *point.positions, *point.velocities, *point.accelerations]
            if k or not rows or row[0] > rows[-1][0] + 1e-9:
                rows.append(row)
                motion.append(number if k else 0)
    if rows and rows[0][0] > 1e-5:
        rows.insert(0, [0.0, *rows[0][1:]])
        motion.insert(0, 0)
    if rows and rows[-1][0] < seconds - 1e-5:
        rows.append([seconds, *rows[-1][1:]])
        motion.append(0)
    n = len(arm.joints)
    if len(rows) < 2 or {len(row) for row in rows} != {1 + 3 * n}:
        raise InputError(
            f"{source}: points", len(rows), f"{n} positions, velocities, accelerations"
        )
    table = np.array(rows)
    if not (np.abs(table) < 1e6).all() or not (np.diff(table[:, 0]) > 1e-6).all():
        raise InputError(
            f"{source}: points", "times or positions", "finite numbers, times that rise"
        )
    knots = Knots(table[:, 0], *np.split(table[:, 1:], 3, axis=1))
    limits, bounds = arm.bounds, knots.bounds()
    out = (bounds.lower < limits.lower - 1e-5) | (bounds.upper > limits.upper + 1e-5)
    used = usage(knots, limits)
    if out.any() or max(used.values()) > 1 + 1e-3:
        worst = max(used, key=lambda name: used[name])
        got = "a joint beyond its range" if out.any() else f"{used[worst]:.3f} of its {worst}"
        raise InputError(f"{source}: motion", got, f"one within the limits of {arm.name}")
    return knots, np.array(motion[1:])


def _states_from(found: dict[str, list[tuple[float, Any]]], speed: float) -> tuple[ToolState, ...]:
    told = [
        *(
            (time, {"width": m.position, "force": m.max_effort})
            for time, m in found["/gripper/command"]
        ),
        *((time, {"vacuum": bool(m.data)}) for time, m in found["/suction/vacuum"]),
        *((time, {"load": m.data}) for time, m in found["/tool/load"]),
        *((time, {"press": m.data}) for time, m in found["/tool/press"]),
    ]
    state = ToolState(0.0, 0.0, speed, 0.0, False, 0.0)
    states = {0.0: state}
    for time, new in sorted(told, key=itemgetter(0)):
        states[time] = state = state._replace(time=time, **new)
    return tuple(states.values())
