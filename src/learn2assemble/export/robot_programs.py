"""Programs of robots as files: URScript (:mod:`.urscript`), tables (:mod:`.robot_tables`), bags
(:mod:`.ros2`).

All of them are made from the record that a build with an arm leaves, by way of a
:class:`~learn2assemble.motion.program.Program` (``docs/robot_programs.md``).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from learn2assemble.assembly.files import read_assembly
from learn2assemble.errors import InputError, check_name, look_up, printable
from learn2assemble.export.formats import file_at
from learn2assemble.export.place_words import place_rows, stands_words
from learn2assemble.export.robot_tables import read_table, write_franka, write_table
from learn2assemble.export.ros2 import is_bag, names_of_two, read_bag, write_bag
from learn2assemble.export.urscript import write_urscript
from learn2assemble.files import as_path, check_exists, check_new, read_json
from learn2assemble.motion.driver import arm_of
from learn2assemble.motion.files import read_record
from learn2assemble.motion.knots import usage
from learn2assemble.motion.places import PickPlace
from learn2assemble.motion.program import Program, make_program
from learn2assemble.motion.record import BuildRecord
from learn2assemble.motion.waits import on_one_clock, with_waits
from learn2assemble.plants.settings import SLOWEST_SHARE, ProgramSettings, read_settings
from learn2assemble.registry import Registry
from learn2assemble.robot.arm import Arm
from learn2assemble.robot.registry import ARMS
from learn2assemble.values import mapping, number

if TYPE_CHECKING:
    from learn2assemble.handling.dry_run import DryRun

# ---------------------------------------------------------------- all formats

PROGRAMS: Registry[tuple[str, Callable[..., None]]] = Registry(
    "format",
    {
        "csv": ("program.csv", write_table),
        "franka": ("program_franka.csv", write_franka),
        "urscript": ("program.script", write_urscript),
        "ros2": ("program.mcap", write_bag),
    },
)
"""Usual file name and writer of every format."""
WHERE = {
    "csv": "line `places` of the header",
    "franka": "line `places` of the header",
    "urscript": "comments at the beginning",
    "ros2": "`places` in the message on /program",
}
"""Where a file of each format says where blocks are taken from."""
_FROM_A_BUILD = re.compile(r"plan\.json|trajectory(-\d+)?\.(json|csv)")
"""Files of a build that are taken for programs: what was planned, and how the arm moved."""
REFILL = {
    "hand": "a person, whom the program asks",
    "feeder": "something that has the next block there in time",
}
"""Who lays blocks where others were taken."""


class Exported(NamedTuple):
    """A program that was written."""

    file: Path
    seconds: float
    """How long the robot takes [s]; of a program that waits for that of another arm, without these
    waits, which a bag of both has."""
    stretch: float
    """Largest factor by which the time of a motion was stretched to stay within the limits."""
    used: dict[str, float]
    """Largest share of the limits of velocity, acceleration and jerk, anywhere in the motion."""
    places: tuple[PickPlace, ...] = ()
    """Where blocks are taken from."""
    speed: float = 1.0
    """Share of the planned speed at which the program begins; ``seconds`` are of all of it."""
    rows: tuple[tuple[str, ...], ...] = ()
    """The places as a table, below :data:`~.place_words.PLACE_HEAD`."""
    stands: str = ""
    """How much else has to stand there, from the start or by hand, in words; empty: nothing."""
    waits: int | None = None
    """How often one arm waits for the other one in it; None: there is one arm."""


def export_program(
    source: BuildRecord | tuple[BuildRecord, BuildRecord] | str | Path,
    format: str,
    path: str | Path,
    *,
    layout: ProgramSettings | str | Path | None = None,
    resume_from: int | None = None,
    speed: float | None = None,
    refill: str | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write the program of a robot that repeats a build.

    Args:
        source: what ``l2a build --arm`` has written: its folder or its ``trajectory.json``; or
            the record of a plan, ``plan.record``. Of a build by two arms: the
            ``trajectory-N.json`` of one of them, beside that of the other one; or both of
            ``plan.records``, that of this arm first. The program then waits for that of the other
            arm where it has to. As ``ros2`` the folder of such a build is one bag of both, on one
            clock.
        format: ``csv``, ``franka``, ``ros2`` or ``urscript``.
        path: a new file, or a folder that gets a file of the usual name; a table whose name ends
            in ``.gz`` is packed.
        layout: of ``urscript``: a layout file, whose section ``program`` says what stands at the
            top of the program (``docs/layouts.md``), or these settings; by default their defaults.
        resume_from: of ``urscript``: number of the first step that the program carries out when
            it is run; by default its first one.
        speed: of ``urscript``: share of the planned speed, 0.001 to 1; by default ``speed_factor``
            of the layout, which is 0.25 where it is not said: slow enough for a first run. Tables
            and bags have the planned speed.
        refill: of ``urscript``: who lays blocks where others were taken. ``hand`` (the default):
            the program stops before each such step and asks a person for the block. ``feeder``: it
            takes the next one without asking, as a magazine of the simulation has it there in time.
        overwrite: ``path`` may also be a file that is there, but none that is read.

    Raises:
        UnknownNameError: naming the nearest format.
        InputError: for a layout or step that cannot be used or is not for the format, a record
            that cannot be used, an arm the format is not for, and a file that is there already or
            cannot be written; an old one is left as it was then.
        MissingExtraError: for ``ros2`` without the extra ``ros2``.
    """
    name, write = PROGRAMS[format]
    file = file_at(path, name)
    check_new(file, "program", source, layout, overwrite=overwrite)  # Before anything is read.
    options: dict[str, Any] = {}
    for word, given in (
        ("layout", layout),
        ("resume_from", resume_from),
        ("speed", speed),
        ("refill", refill),
    ):
        if given is not None and format != "urscript":
            raise InputError(word, f"a value for the format {format}", "the format urscript")
    if format == "urscript":
        settings = ProgramSettings() if layout is None else layout
        if isinstance(settings, str | Path):
            settings = read_settings(settings)
        if not isinstance(settings, ProgramSettings):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError("layout", settings, "ProgramSettings, or a layout file")
        if speed is not None:
            if not SLOWEST_SHARE <= number(speed, "speed") <= 1:
                raise InputError("speed", speed, f"{SLOWEST_SHARE:g} to 1")
            settings = replace(settings, speed_factor=float(speed))
        check_name("refill", refill or "hand", REFILL)
        options = {"settings": settings, "resume_from": resume_from, "refill": refill or "hand"}
    both = None if format != "ros2" or not isinstance(source, str | Path) else _of_two(Path(source))
    records = _records_of(source if both is None else both)
    if not all(isinstance(one, BuildRecord) for one in records) or len(records) not in (1, 2):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError("source", source, "a BuildRecord (of a plan its .record), or a folder")
    moved = [one for one in records if any(len(step.samples.time) for step in one.steps)]
    if len(records) == 2 and len(moved) == 1 and (both is not None or moved[0] is records[0]):
        # The other arm had nothing to do: nobody waits for it.
        records, both = (moved[0],), None
    arms = [arm_of(record.arm) for record in records]
    made = [make_program(*one) for one in zip(records, arms, strict=True)]
    if len(made) == 2:
        made = [*with_waits((made[0], made[1]), (arms[0], arms[1]))]
    if both is not None:
        options["across"] = made[1], arms[1]
    program, arm = made[0], arms[0]
    write(program, arm, file, **options)
    shown = list(zip(made, arms, strict=True))[: 1 if both is None else 2]
    shares = [usage(one.knots, its.bounds) for one, its in shown]
    used = {name: max(share[name] for share in shares) for name in shares[0]}
    long = made[:1] if both is None else on_one_clock((made[0], made[1]))
    # Each arm counts its places from 1: of two it is said whose they are.
    names = [f"{name} " for name in names_of_two(*(one.arm for one in made))] if both else [""]
    told = options.get("settings")
    frame = None if told is None else told.base_frame
    return Exported(
        file,
        max(one.seconds for one in long),
        max(one.stretch for one, _ in shown),
        used,
        tuple(place for one, _ in shown for place in one.places),
        1.0 if told is None else told.speed_factor,
        tuple(
            (f"{name}{row[0]}", *row[1:])
            for name, (one, its) in zip(names, shown, strict=True)
            for row in place_rows(one, its, frame)
        ),
        stands_words(program),
        sum(len(one.waits) for one, _ in shown) if len(made) == 2 else None,
    )


def _of_two(path: Path) -> Path | None:
    """The first record of a folder in which two arms have built; None for all else."""
    folder = path.parent if path.name == "plan.json" else path
    first = folder / "trajectory-1.json"
    return None if (folder / "trajectory.json").is_file() or not first.is_file() else first


def _records_of(
    source: BuildRecord | tuple[BuildRecord, ...] | str | Path,
) -> tuple[BuildRecord, ...]:
    """The record of an arm, and that of the other arm, if two have built."""
    if not isinstance(source, str | Path):
        return source if isinstance(source, tuple) else (source,)
    path = Path(source)
    record = _read_record(path)
    if found := re.fullmatch(r"trajectory-([12])\.json", path.name):
        across = path.with_name(f"trajectory-{3 - int(found[1])}.json")
        check_exists(across, "record of the other arm, for which this one has to wait")
        other = read_record(across)
        both = zip(_called(record), _called(other), strict=False)
        if any(one != two for one, two in both if one[0] and two[0]):
            got = "a record with other blocks"
            raise InputError(printable(str(across)), got, f"that of the build of {path.name}")
        return record, other
    return (record,)


def _called(record: BuildRecord) -> list[tuple[str, str]]:
    """Name and kind of every block; what an arm has lost meanwhile is behind them."""
    return list(zip(record.names, record.kinds, strict=True))


def _read_record(path: Path) -> BuildRecord:
    check_exists(path, "folder of a build with an arm (l2a build --arm), or its trajectory.json")
    file = path / "trajectory.json" if path.is_dir() else path
    if file.name == "plan.json":
        file = file.with_name("trajectory.json")
    if not file.is_file() and file.with_name("trajectory-1.json").is_file():
        expected = "the trajectory-N.json of one of them: only a bag (ros2) has both"
        raise InputError("PLAN", f"{path}, a build by several arms", expected)
    if not file.is_file():
        expected = "the folder of a build with an arm (l2a build --arm), or its trajectory.json"
        status = _status(file.with_name("plan.json"))
        why = f", which has no program: it is {status}" if status != "complete" else ""
        raise InputError("PLAN", f"{path}{why}", expected)
    record, told = read_record(file), file.with_name("assembly.json")
    if record.names or not told.is_file():
        return record
    # Records of older versions do not say what their blocks are called.
    blocks = read_assembly(told).blocks[: len(record.objects)]
    left = [""] * (len(record.objects) - len(blocks))
    names, kinds = ([*(getattr(b, key) for b in blocks), *left] for key in ("id", "kind"))
    return replace(record, names=tuple(names), kinds=tuple(kinds))


def _status(file: Path) -> str:
    """That of a plan; ``complete`` too where the file says nothing of it."""
    if not file.is_file():
        return "complete"
    plan, source = read_json(file, "plan")
    status: object = mapping(plan, source).get("status")
    return status if isinstance(status, str) else "complete"


def read_program(path: str | Path, arm: str) -> tuple[Program, Arm]:
    """Read a program that :func:`export_program` has written as a table or a bag.

    Args:
        path: the file.
        arm: name of the arm that is to play it.

    Returns:
        the program, and the arm with its tool where it stood.

    Raises:
        InputError: for a file that is damaged, incomplete, for another arm, or of the build itself
            (its ``trajectory.json`` and ``.csv``), and for motions beyond the limits of the arm.
        MissingExtraError: for a bag without the extra ``ros2``.
    """
    path = as_path(path, "program")
    look_up("arm", arm, ARMS)
    urscript = path.suffix.lower() == ".script"
    if urscript or path.is_dir() or _FROM_A_BUILD.fullmatch(path.name):
        got = "a folder" if path.is_dir() else "a file of the build itself"
        got = "a URScript, which only a UR controller plays" if urscript else got
        expected = "a program, which l2a export makes of a build (csv, franka or ros2)"
        raise InputError(printable(str(path)), got, expected)
    return (read_bag if is_bag(path) else read_table)(path, arm)


def replay_program(path: str | Path, arm: str) -> DryRun:
    """Play an exported table or bag in the dynamic cell, from beginning to end without looking.

    Args:
        path: what :func:`export_program` has written as ``csv``, ``franka`` or ``ros2``.
        arm: name of the arm that is to play it.

    Raises:
        InputError: see :func:`read_program`.
        MissingExtraError: without the extra ``robot``.
    """
    from learn2assemble.handling.dry_run import play

    return play(*read_program(path, arm))
