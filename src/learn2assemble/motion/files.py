"""``trajectory.json`` and ``trajectory.csv`` (``docs/trajectory.md``).

Numbers are rounded to six decimals (micrometres, microradians), so the same record gives the same
bytes, and reading and writing a file again changes nothing.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.files import read_json, write_file
from learn2assemble.geometry.hulls import Hull, hull_of
from learn2assemble.motion.record import ArmFacts, BuildRecord, ByHand, Samples, Stage, StepRecord
from learn2assemble.robot.moves import STAGES, Outcome
from learn2assemble.robot.studs import GROUND, StudJoint, Studs
from learn2assemble.values import integer, rounded_array

FORMAT, VERSION = "learn2assemble-trajectory", 5
UNITS = (
    "s, m, rad; world frame, z up; base_yaw turns the model of the arm, "
    "arm.base of plan.json says which way it faces"
)
"""A reminder for who opens the file."""
DECIMALS = 6
MOST, MOST_JOINT = 1e6, 100.0
"""Largest magnitudes of numbers and of joint angles [rad] in a file."""
OUTCOMES = {outcome.label: outcome for outcome in Outcome}
"""By label."""


def write_record(record: BuildRecord, path: Path) -> None:
    """Write ``trajectory.json``.

    Raises:
        InputError: where ``path`` cannot be written, or the record holds no finite number.
    """
    write_file(path, _text(record_data(record)) + "\n", "trajectory")


def read_record(path: Path) -> BuildRecord:
    """Read what :func:`write_record` has written.

    Raises:
        InputError: where it is no such file; :func:`~.record.find_fault` looks further.
    """
    data, _ = read_json(path, "trajectory.json")
    return record_from(data)


def record_data(record: BuildRecord) -> dict[str, Any]:
    """The content of ``trajectory.json``: plain numbers, words and lists."""
    head = {"format": FORMAT, "version": VERSION, "units": UNITS}
    steps: list[dict[str, Any]] = []
    for step in map(_plain, record.steps):
        samples = step.pop("samples")
        if step["source"] is None:
            del step["source"]
        steps.append({"step": step.pop("number"), **step, **samples})
    data: dict[str, Any] = {
        **head,
        **_plain(dataclasses.replace(record, steps=(), studs=None)),
        "steps": steps,
    }
    del data["studs"]
    # Older versions did not tell when.
    data["hands"] = [one if one[4] is not None else one[:4] for one in data["hands"]]
    for key in ("names", "kinds"):
        if not data[key]:
            del data[key]
    return data if record.studs is None else {**data, "studs": _plain(studs_data(record.studs))}


def record_from(data: Any) -> BuildRecord:
    """The record that a parsed ``trajectory.json`` describes.

    Raises:
        InputError: where it is none, naming the field.
    """
    told = type(data).__name__
    data = cast("Mapping[str, Any]", data) if isinstance(data, Mapping) else dict[str, Any]()
    if data.get("format") != FORMAT:
        raise InputError("trajectory", told, f"a {FORMAT} file")
    if integer(data.get("version"), "trajectory.version") != VERSION:
        raise InputError("trajectory.version", data["version"], str(VERSION))
    where = "trajectory"
    try:
        arm = _arm_from(data["arm"])
        objects = tuple(tuple(int(c) for c in cells) for cells in data["objects"])
        count, steps = sum(map(len, objects)), list[StepRecord]()
        for k, item in enumerate(data["steps"]):
            where = f"trajectory.steps[{k}]"
            steps.append(_step_from(item, where, len(arm.joints), count))
        where = "trajectory"
        return BuildRecord(
            arm,
            _number("rate", data["rate"]),
            _number("block_edge", data["block_edge"]),
            objects,
            str(data["simulated_by"]),
            tuple(steps),
            None if data["half"] is None else _array("half", data["half"], (count, 3)),
            None if data["density"] is None else _array("density", data["density"], (count,)),
            None if data["hull"] is None else tuple(map(_hull_from, data["hull"])),
            tuple(map(ByHand.read, data["hands"])),
            None if data.get("studs") is None else studs_from(data["studs"], count),
            *(_words_from(data, key, len(objects)) for key in ("names", "kinds")),
        )
    except KeyError as error:
        raise InputError(where, f"no field {error}", f"every field of a {FORMAT} file") from None
    except (TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, str(error), f"a {FORMAT} file") from None


def _words_from(data: Mapping[str, Any], key: str, count: int) -> tuple[str, ...]:
    """A word for every object, or none at all."""
    found = tuple(map(str, data.get(key, ())))
    if len(found) not in (0, count):
        raise InputError(key, len(found), f"one for each of {count} objects")
    return found


def _hull_from(value: Any) -> Hull | None:
    if value is None:
        return None
    try:
        return hull_of(_array("hull", value, (len(value), 3)))
    except ValueError as error:
        raise InputError("hull", str(error), "corners of a solid") from None


def _arm_from(data: Mapping[str, Any]) -> ArmFacts:
    joints = tuple(map(str, data["joints"]))
    limits = [
        _array(f"arm.{key}", data[key], (len(joints),))
        for key in ("lower", "upper", "velocity", "acceleration")
    ]
    return ArmFacts(
        str(data["name"]),
        joints,
        *limits,
        base_position=_array("arm.base_position", data["base_position"], (3,)),
        base_yaw=_number("arm.base_yaw", data["base_yaw"]),
        tool=str(data["tool"]),
        max_width=_number("arm.max_width", data["max_width"]),
        tool_name=str(data["tool_name"]),
        suction=data["suction"] is True,
    )


def _step_from(item: Mapping[str, Any], where: str, n: int, cells: int) -> StepRecord:
    times, outcome = len(item["time"]), item["outcome"]
    if outcome not in OUTCOMES:
        raise UnknownNameError(f"{where}.outcome", outcome, OUTCOMES)
    for name, *_ in item["stages"]:
        if name not in STAGES:
            raise UnknownNameError(f"{where}.stages", name, STAGES)

    def array(key: str, *shape: int, most: float = MOST) -> np.ndarray:
        return _array(f"{where}.{key}", item[key], shape, most)

    def time(key: str) -> float | None:
        return None if item[key] is None else float(array(key))

    stages = tuple(
        Stage(str(name), *_array(f"{where}.stages", span, (2,)).tolist())
        for name, *span in item["stages"]
    )
    samples = Samples(
        array("time", times),
        array("joints", times, n, most=MOST_JOINT),
        array("velocity", times, n),
        array("width", times),
        array("command", times),
    )
    return StepRecord(
        int(item["step"]),
        None if item["plan_step"] is None else int(item["plan_step"]),
        tuple(int(c) for c in item["cells"]),
        array("target", 7),
        OUTCOMES[outcome],
        str(item["detail"]),
        bool(item["replanned"]),
        stages,
        time("grip"),
        time("release"),
        samples,
        array("before", cells, 7),
        array("after", cells, 7),
        None if item["truth"] is None else array("truth", cells, 7),
        None if item.get("source") is None else array("source", 7),
    )


def _plain(value: Any) -> Any:
    """Dataclasses, tuples, outcomes and rounded numbers as JSON values."""
    if isinstance(value, Outcome):
        return value.label
    if isinstance(value, Hull):
        return _plain(value.points)
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, tuple):
        return [_plain(item) for item in cast("tuple[Any, ...]", value)]
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in cast("dict[str, Any]", value).items()}
    if isinstance(value, list):
        return [_plain(item) for item in cast("list[Any]", value)]
    if value is None or isinstance(value, str | bool | int):
        return value
    array = np.asarray(value, float)
    if not np.isfinite(array).all():
        raise InputError("trajectory", array.tolist(), "finite numbers")
    return rounded_array(array, DECIMALS).tolist()


def _number(what: str, value: Any) -> float:
    return float(_array(what, value, ()))


def _array(what: str, value: Any, shape: tuple[int, ...], most: float = MOST) -> np.ndarray:
    """Plain numbers as float64 of this shape, of at most this magnitude, or an InputError."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        array = np.full((1,) * (len(shape) + 1), np.nan)
    if array.size == 0 and 0 in shape:
        return np.empty(shape)
    if array.shape != shape or not (np.abs(array) <= most).all():
        size = " x ".join(map(str, shape))
        words = f"{size} finite numbers" if shape else "a finite number"
        raise InputError(what, value, f"{words}, at most {most:g}")
    return array


def _text(value: Any, indent: int = 0) -> str:
    """JSON with one line per row of numbers, and everything else indented."""
    items = cast("dict[str, Any]", value) if isinstance(value, dict) else dict[str, Any]()
    inner: list[Any] = [*items.values()] if isinstance(value, dict) else value
    if not isinstance(value, dict | list) or not any(isinstance(v, dict | list) for v in inner):
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    if isinstance(value, dict):
        parts = [f"{json.dumps(k)}: {_text(v, indent + 1)}" for k, v in items.items()]
        left, right = "{", "}"
    else:
        parts = [_text(v, indent + 1) for v in inner]
        left, right = "[", "]"
    between = "\n" + " " * (indent + 1)
    return left + between + f",{between}".join(parts) + between[:-1] + right


def csv_header(joints: tuple[str, ...], suction: bool = False) -> list[str]:
    """Names of the columns of ``trajectory.csv``, with units."""
    return [
        "step",
        "stage",
        "time [s]",
        *(f"{name} [rad]" for name in joints),
        *(f"{name} velocity [rad/s]" for name in joints),
        "suction (1: on)" if suction else "gripper width [m]",
    ]


def write_csv(record: BuildRecord, path: Path) -> None:
    """Write ``trajectory.csv``: one line per sample.

    Raises:
        InputError: where ``path`` cannot be written.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(csv_header(record.arm.joints, record.arm.suction))
    for step in record.steps:
        samples = step.samples
        tool = samples.command if record.arm.suction else samples.width
        numbers = np.column_stack([samples.time, samples.joints, samples.velocity, tool])
        for time, row in zip(
            samples.time.tolist(), rounded_array(numbers, DECIMALS).tolist(), strict=True
        ):
            cells = (f"{value:.{DECIMALS}f}" for value in row)
            writer.writerow([step.number, step.stage_at(time), *cells])
    write_file(path, out.getvalue(), "trajectory table")


# ---------------------------------------------------------------- joints of studs, also of programs

_JOINT = ("lower", "upper", "at", "pull", "middle", "hull", "face")


def studs_data(studs: Studs) -> dict[str, Any]:
    """Joints as plain values; none of them is home yet.

    Args:
        studs: whose bricks are numbers of cells.
    """
    joints = [{name: getattr(joint, name) for name in _JOINT} for joint in studs.joints]
    return {"press": studs.press, "joints": joints}


def studs_from(data: Mapping[str, Any], cells: int) -> Studs:
    """What :func:`studs_data` has made.

    Args:
        cells: how many there are.

    Raises:
        ValueError: for anything else; also KeyError and TypeError.
    """
    made: list[StudJoint] = []
    for one in data["joints"]:
        lower, upper = int(one["lower"]), int(one["upper"])
        if not (GROUND <= lower < cells and 0 <= upper < cells and lower != upper):
            raise ValueError(f"a joint of cells {lower} and {upper} of {cells}")
        hull, (low, high) = one["hull"], one["face"]
        x, y, z = _numbers(one["at"], 3)
        (pull,) = _numbers([one["pull"]], 1)
        made.append(
            StudJoint(
                lower,
                upper,
                (x, y, z),
                pull,
                _point(one["middle"]),
                tuple(map(_point, hull)),
                (_point(low), _point(high)),
                False,
            )
        )
    (press,) = _numbers([data["press"]], 1)
    if press <= 0:
        raise ValueError(f"a press of {press:g} N")
    return Studs(tuple(made), press)


def _point(value: Sequence[float]) -> tuple[float, float]:
    x, y = _numbers(value, 2)
    return x, y


def _numbers(value: Sequence[float], count: int) -> list[float]:
    array = np.array(value, float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{value} instead of {count} finite numbers")
    return array.tolist()
