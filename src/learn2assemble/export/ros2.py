"""Programs as ROS 2 bags (MCAP), without ROS.

A motion is a ``JointTrajectory`` of its knots, between which the controllers of ROS 2 follow the
same quintic; a bag therefore holds the program exactly. Messages are those of ROS 2 Humble and
later; their topics are listed in ``docs/robot_programs.md``.
"""

from __future__ import annotations

import colorsys
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.export.robot_tables import MOST_BYTES, header, read_header
from learn2assemble.files import load_json, read_bytes, write_file
from learn2assemble.geometry.rotations import (
    matrix_quaternion,
    quaternion_matrix,
    quaternion_product,
    rotate_vectors,
)
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.kinematics import forward_many, get_chain
from learn2assemble.robot.motion.program import (
    Knots,
    Program,
    ToolState,
    driver_of,
    limits_of,
    usage,
)
from learn2assemble.robot.moves import STAGES

STATE_RATE = 50.0
"""Joint states and transforms per second."""

_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start"
    ),
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\n"
        "int32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n"
        "int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\n"
        "int32 ARROW_STRIP=12\nint32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\n"
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\n"
        "string text\nstring mesh_resource\nvisualization_msgs/MeshFile mesh_file\n"
        "bool mesh_use_embedded_materials"
    ),
}
"""Definitions of the messages that others contain (ROS 2 Humble and later)."""
_TYPES = {
    "trajectory_msgs/msg/JointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint[] points"
    ),
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort"
    ),
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort",
    "std_msgs/msg/Bool": "bool data",
    "std_msgs/msg/Float64": "float64 data",
    "std_msgs/msg/String": "string data",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "visualization_msgs/msg/MarkerArray": "visualization_msgs/Marker[] markers",
}
_TOPICS = {
    "/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/gripper/command": "control_msgs/msg/GripperCommand",
    "/suction/vacuum": "std_msgs/msg/Bool",
    "/tool/load": "std_msgs/msg/Float64",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/blocks": "visualization_msgs/msg/MarkerArray",
    "/stage": "std_msgs/msg/String",
    "/check": "std_msgs/msg/String",
    "/program": "std_msgs/msg/String",
}


def _definition(text: str) -> str:
    """A definition, followed by those of all messages it contains."""
    needed: list[str] = []

    def visit(body: str) -> None:
        for line in body.splitlines():
            part = line.split()[0].partition("[")[0]
            if part in _PARTS and part not in needed:
                needed.append(part)
                visit(_PARTS[part])

    visit(text)
    rule = "=" * 80
    return "\n".join([text, *(f"{rule}\nMSG: {part}\n{_PARTS[part]}" for part in needed)])


def write_bag(program: Program, arm: Arm, path: Path) -> None:
    """Write a bag; time 0 is the beginning of the program.

    Raises:
        MissingExtraError: without the extra ``ros2``.
        InputError: where it cannot be written.
    """
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise MissingExtraError("mcap-ros2-support", "ros2") from error
    out = io.BytesIO()
    writer = Writer(out)
    schemas = {
        kind: writer.register_msgdef(kind, _definition(text)) for kind, text in _TYPES.items()
    }
    messages = [
        *_head_messages(program, arm), *_motion_messages(program, arm),
        *_tool_messages(program), *_scene_messages(program, arm),
    ]  # fmt: skip
    for time, topic, message in sorted(messages, key=lambda entry: entry[0]):
        writer.write_message(topic, schemas[_TOPICS[topic]], message, time, time)
    writer.finish()
    write_file(path, out.getvalue(), "bag")


Message = tuple[int, str, dict[str, Any]]
"""Time [ns], topic, content."""


def _head_messages(program: Program, arm: Arm) -> list[Message]:
    found: list[Message] = [(0, "/program", {"data": json.dumps(header(program, arm))})]
    piece_step, stage, last = program.step, program.stage, (-1, -1)
    cells = {step.number: step.cells[0] for step in program.steps}
    for k, now in enumerate(zip(piece_step.tolist(), stage.tolist(), strict=True)):
        if now != last:
            name = STAGES[now[1]] if now[1] >= 0 else "rest"
            words = f"step {now[0]}, block {cells.get(now[0], -1)}: {name}"
            found.append((_ns(float(program.knots.time[k])), "/stage", {"data": words}))
        last = now
    for step in program.steps:
        for time in step.checks:
            found.append((_ns(time), "/check", {"data": f"block {step.cells[0]}"}))
    return found


def _motion_messages(program: Program, arm: Arm) -> list[Message]:
    names, knots = list(driver_of(arm).joints), program.knots
    found: list[Message] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], program.motion, [0]])))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if not program.motion[begin]:
            continue
        start = _ns(float(knots.time[begin]))
        points = [
            {
                "positions": knots.position[k].tolist(), "velocities": knots.velocity[k].tolist(),
                "accelerations": knots.acceleration[k].tolist(), "effort": [],
                "time_from_start": _stamp(_ns(float(knots.time[k])) - start),
            }
            for k in range(begin, end + 1)
        ]  # fmt: skip
        message = {"header": _header(start, "world"), "joint_names": names, "points": points}
        found.append((start, "/joint_trajectory", message))
    time = _grid(program)
    for t, q, v in zip(time.tolist(), *(part.tolist() for part in knots.at(time)[:2]), strict=True):
        state = {"name": names, "position": q, "velocity": v, "effort": []}
        found.append((_ns(t), "/joint_states", {"header": _header(_ns(t), ""), **state}))
    return found


def _tool_messages(program: Program) -> list[Message]:
    found: list[Message] = []
    before: ToolState | None = None
    for state in program.states:
        time = _ns(state.time)
        grip = {"position": state.width, "max_effort": state.force}
        if program.suction:
            if before is None or state.vacuum != before.vacuum:
                found.append((time, "/suction/vacuum", {"data": state.vacuum}))
        elif before is None or (state.width, state.force) != (before.width, before.force):
            found.append((time, "/gripper/command", grip))
        if before is None or state.load != before.load:
            found.append((time, "/tool/load", {"data": state.load}))
        before = state
    return found


def _scene_messages(program: Program, arm: Arm) -> list[Message]:
    """Frames of robot, tool point and cells, and the markers in these."""
    driver, blocks = driver_of(arm), program.blocks
    # The flange is where the tool point, which moves, says it is.
    turn = driver.tcp[3:] * [1, -1, -1, -1]
    flange = np.concatenate([-rotate_vectors(turn[None], driver.tcp[None, :3])[0], turn])
    fixed = [
        _transform(0, "world", driver.base_frame, driver.base),
        _transform(0, "tcp", driver.flange_frame, flange),
    ]
    found: list[Message] = [(0, "/tf_static", {"transforms": fixed})]
    markers = []
    for number, cells in enumerate(blocks.objects):
        red, green, blue = colorsys.hsv_to_rgb(number * 0.381966 % 1, 0.55, 0.85)
        markers += [_marker(c, 2 * blocks.halves[c], (red, green, blue)) for c in cells]
    found.append((0, "/blocks", {"markers": markers}))
    time = _grid(program)
    position, rotation = forward_many(
        get_chain(arm), np.ascontiguousarray(program.knots.at(time)[0])
    )
    tool = [
        np.concatenate([p, matrix_quaternion(r)]) for p, r in zip(position, rotation, strict=True)
    ]
    poses, now, held = blocks.start, 0, {}
    for k, t in enumerate(time.tolist()):
        changed = set(range(len(poses))) if k == 0 else set()
        while now < len(program.steps) and t >= program.steps[now].end - 1e-9:
            after = program.steps[now].after
            after = poses if after is None else after
            changed |= set(np.flatnonzero(np.any(poses != after, axis=1)).tolist())
            poses, now, held = after, now + 1, {}
        if now < len(program.steps) and (span := program.steps[now].held) is not None:
            step = program.steps[now]
            if not held and span[0] <= t <= span[1]:
                held = {cell: _inverse_product(tool[k], poses[cell]) for cell in step.cells}
            if held and t <= span[1]:
                poses = poses.copy()
                for cell, offset in held.items():
                    poses[cell] = _product(tool[k], offset)
                changed |= set(held)
        transforms = [_transform(_ns(t), "world", "tcp", tool[k])]
        transforms += [_transform(_ns(t), "world", f"cell_{c}", poses[c]) for c in sorted(changed)]
        found.append((_ns(t), "/tf", {"transforms": transforms}))
    return found


def _grid(program: Program) -> np.ndarray:
    count = int(np.ceil(program.seconds * STATE_RATE - 1e-6))
    return np.minimum(np.arange(count + 1) / STATE_RATE, program.seconds)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    moved = a[:3] + rotate_vectors(a[None, 3:], b[None, :3])[0]
    return np.concatenate([moved, quaternion_product(a[3:], b[3:])])


def _inverse_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
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
        "header": _header(time, parent), "child_frame_id": child,
        "transform": {
            "translation": {"x": x, "y": y, "z": z},
            "rotation": dict(zip("wxyz", turn, strict=True)),
        },
    }  # fmt: skip


def _marker(cell: int, size: np.ndarray, colour: tuple[float, float, float]) -> dict[str, Any]:
    still = {"position": {"x": 0.0, "y": 0.0, "z": 0.0},
             "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}  # fmt: skip
    none = {"sec": 0, "nanosec": 0}
    return {
        "header": {"stamp": none, "frame_id": f"cell_{cell}"}, "ns": "blocks", "id": cell,
        "type": 1, "action": 0, "pose": still,
        "scale": dict(zip("xyz", size.tolist(), strict=True)),
        "color": {**dict(zip("rgb", colour, strict=True)), "a": 1.0}, "lifetime": none,
        "frame_locked": True, "points": [], "colors": [], "texture_resource": "",
        "texture": {"header": {"stamp": none, "frame_id": ""}, "format": "", "data": b""},
        "uv_coordinates": [], "text": "", "mesh_resource": "",
        "mesh_file": {"filename": "", "data": b""}, "mesh_use_embedded_materials": False,
    }  # fmt: skip


_DAMAGE = (ValueError, TypeError, LookupError, AttributeError, OverflowError, MemoryError)
"""What a reader of bags raises where bytes are not what they should be, besides errors of its
own."""


def read_bag(path: Path, name: str) -> tuple[Program, Arm]:
    """Read what :func:`write_bag` has written.

    Raises:
        InputError: see :func:`.robot_programs.read_program`.
        MissingExtraError: without the extra ``ros2``.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
        from zstandard import ZstdError
    except ImportError as error:
        raise MissingExtraError("mcap-ros2-support", "ros2") from error
    content, source = read_bytes(path, "bag", MOST_BYTES)
    wanted = ["/program", "/joint_trajectory", "/gripper/command", "/suction/vacuum", "/tool/load"]
    found: dict[str, list[tuple[float, Any]]] = {topic: [] for topic in wanted}
    try:
        reader = make_reader(io.BytesIO(content), True, [DecoderFactory()])  # checks sums
        for _, channel, entry, message in reader.iter_decoded_messages(topics=wanted):
            found[channel.topic].append((entry.log_time / 1e9, message))
    except (McapError, ZstdError, struct.error, EOFError, *_DAMAGE) as error:
        got = str(error) or type(error).__name__
        raise InputError(source, got, "a bag that is whole") from None
    if not found["/program"] or not found["/joint_trajectory"]:
        raise InputError(source, "no program in it", "a bag that l2a export has written")
    head = load_json(found["/program"][0][1].data, f"{source}: /program", "header")
    told = read_header(head, source, name)
    arm = told.arm
    knots, motion = _knots_from(found["/joint_trajectory"], told.seconds, arm, source)
    none = np.zeros(len(motion), np.int64)
    program = Program(
        name, arm.tool_name, arm.suction is not None, knots, none.astype(np.int8) - 1, none,
        motion, _states_from(found, told.speed), told.steps, told.blocks, told.stretch,
    )  # fmt: skip
    return program, arm


def _knots_from(
    messages: list[tuple[float, Any]], seconds: float, arm: Arm, source: str
) -> tuple[Knots, np.ndarray]:
    """All motions in a row, with rest between them, within the limits of the arm."""
    rows, motion = [], []
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
    limits, bounds = limits_of(arm), knots.bounds()
    out = (bounds.lower < limits.lower - 1e-5) | (bounds.upper > limits.upper + 1e-5)
    used = usage(knots, limits)
    if out.any() or max(used.values()) > 1 + 1e-3:
        worst = max(used, key=lambda name: used[name])
        got = "a joint beyond its range" if out.any() else f"{used[worst]:.3f} of its {worst}"
        raise InputError(f"{source}: motion", got, f"one within the limits of {arm.name}")
    return knots, np.array(motion[1:])


def _states_from(found: dict[str, list[tuple[float, Any]]], speed: float) -> tuple[ToolState, ...]:
    state = ToolState(0.0, 0.0, speed, 0.0, False, 0.0)
    changes = [
        (time, change)
        for topic, read in (
            ("/gripper/command", lambda m: {"width": m.position, "force": m.max_effort}),
            ("/suction/vacuum", lambda m: {"vacuum": bool(m.data)}),
            ("/tool/load", lambda m: {"load": m.data}),
        )
        for time, message in found[topic]
        for change in [read(message)]
    ]
    states = [state]
    for time, change in sorted(changes, key=lambda entry: entry[0]):
        state = state._replace(time=time, **change)
        states = [*states[:-1], state] if states[-1].time == time else [*states, state]
    return tuple(states)
