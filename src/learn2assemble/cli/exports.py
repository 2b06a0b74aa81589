"""Commands that write files of other programs: exports, programs of robots, arms of one's own."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from learn2assemble.cli.parser import Command, arg, command, named, overwrite_argument, percent
from learn2assemble.errors import InputError, look_up
from learn2assemble.robot.registry import ARMS

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output

COMMANDS: dict[str, Command] = {}
_PLACE_KEYS = ("place", "kind", "blocks", "world_mm", "turn_deg", "base_mm", "refill")
"""Of a place in the result of ``l2a export``, as the table on the terminal has it."""
DIFFERS = 1
"""Exit code of ``l2a replay-trajectory`` where another structure results."""


def _format_argument(parser: argparse.ArgumentParser) -> None:
    from learn2assemble.export import PROGRAM_FORMATS
    from learn2assemble.export.formats import FORMATS

    words = f"{', '.join(FORMATS)}; of a build with an arm: {', '.join(PROGRAM_FORMATS)}"
    parser.add_argument("--format", required=True, help=words)


@command(
    COMMANDS,
    "export",
    "a plan as GLB, MJCF, COMPAS, bill of blocks or step cards, or as program of a robot",
    "l2a export out/house --format glb",
    arg("plan", metavar="PLAN", type=named, help="folder of a plan, its plan.json, or an assembly"),
    _format_argument,
    arg("--out", type=named, default=Path(), metavar="PATH", help="new file, or folder (here)"),
    overwrite_argument,
    arg(
        "--layout",
        type=named,
        metavar="FILE",
        help="urscript: layout whose section `program` has speed, inputs, outputs, taught frame",
    ),
    arg("--resume-from", type=int, metavar="N", help="urscript: leave out the steps before N"),
    arg("--speed", type=percent, metavar="SHARE", help="urscript: of the plan's, as 50%% (25%%)"),
    arg(
        "--refill",
        metavar="WHO",
        help="urscript: who lays blocks where others were taken: hand, the program asks (default), "
        "or feeder, it does not ask",
    ),
)
def _export(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.assembly.files import read_assembly
    from learn2assemble.assembly.instructions.appearance import unbuilt_words
    from learn2assemble.export import PROGRAM_FORMATS
    from learn2assemble.export.formats import FORMATS, check_target, export_assembly

    if options.format in PROGRAM_FORMATS:
        return _export_program(options, output)
    # A wrong name is refused before anything is read.
    look_up("format", options.format, {**FORMATS, **dict.fromkeys(PROGRAM_FORMATS)})
    for word in ("layout", "resume_from", "speed", "refill"):
        if getattr(options, word) is not None:
            got = f"a value for the format {options.format}"
            raise InputError(f"--{word.replace('_', '-')}", got, "the format urscript")
    # Whose file is there is looked at before anything is read.
    file = check_target(options.plan, options.format, options.out, overwrite=options.overwrite)
    try:
        assembly = read_assembly(options.plan, unit=None)
    except InputError as error:
        if error.what != "unit":
            raise
        got = f"{options.plan}, which does not say its unit"
        way = "l2a build --blocks --unit makes of others"
        raise InputError("PLAN", got, f"a file that does, or the plan that {way}") from None
    written = export_assembly(assembly, options.format, file, overwrite=options.overwrite)
    output.say(f"{options.format}: {written}")
    if left := unbuilt_words(assembly):
        output.paragraph(f"blocks: {left}")
    if options.format == "mjcf" and assembly.holds:
        words = "joints of studs or mortar are not in it: there the blocks are dry, and may fall"
        output.paragraph(f"warning: {words}")
    left_out = list(assembly.not_built)
    output.finish({"format": options.format, "file": str(written), "not_built": left_out})


def _export_program(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.assembly.instructions.words import count_words
    from learn2assemble.export.place_words import PLACE_HEAD
    from learn2assemble.export.robot_programs import WHERE, export_program

    done = export_program(
        options.plan,
        options.format,
        options.out,
        layout=options.layout,
        resume_from=options.resume_from,
        speed=options.speed,
        refill=options.refill,
        overwrite=options.overwrite,
    )
    if done.rows:
        output.table("blocks are taken from", PLACE_HEAD, done.rows)
    if done.stands:
        output.say(done.stands)
    used = ", ".join(f"{name} {100 * share:.0f} %" for name, share in done.used.items())
    output.say(f"{options.format}: {done.file}")
    output.say(f"{done.seconds:.1f} s, of the limits at most {used}")
    output.say(f"time stretched by {done.stretch:.3f} at most")
    if options.format == "urscript":
        output.say(
            f"speed: {100 * done.speed:g} % of the planned one, about "
            f"{done.seconds / done.speed:.0f} s; --speed says another share"
        )
    output.say(f"where blocks, base and arm have to be: {WHERE[options.format]}")
    if done.waits is not None:
        output.say(f"two arms that wait for one another, {count_words(done.waits, 'time')} in here")
    output.finish(
        {
            "format": options.format,
            "file": str(done.file),
            "seconds": round(done.seconds, 3),
            "stretch": round(done.stretch, 6),
            "used": {name: round(share, 6) for name, share in done.used.items()},
            "speed": done.speed,
            "waits": done.waits,
            "places": [dict(zip(_PLACE_KEYS, row, strict=True)) for row in done.rows],
        }
    )


@command(
    COMMANDS,
    "add-arm",
    "make an arm of one's own from its URDF",
    "l2a add-arm mine.urdf --out arms/mine",
    arg("urdf", metavar="URDF", type=named, help="its file; meshes beside it, as it names them"),
    arg("--out", type=named, required=True, metavar="DIR", help="the arm's folder and its name"),
    arg("--flange", default=None, help="link that tools are fixed to, z out of it (the last one)"),
    arg("--payload", type=float, default=None, help="largest mass that it carries, with its tool"),
)
def _add_arm(options: argparse.Namespace, output: Output) -> int:
    from learn2assemble.robot.own_arms import PLACE
    from learn2assemble.robot.urdf import arm_from_urdf

    file = arm_from_urdf(options.urdf, options.out, flange=options.flange, payload=options.payload)
    output.say(f"arm {options.out.name}: {file}")
    output.say(f"commands know it with {PLACE}={options.out.parent}")
    output.finish({"arm": options.out.name, "file": str(file)})
    return 0


@command(
    COMMANDS,
    "replay-trajectory",
    "play an exported program of a robot in the simulation, without looking",
    "l2a replay-trajectory out/program.csv --arm panda",
    arg("file", metavar="FILE", type=named, help="what l2a export wrote as csv, franka, ros2"),
    arg("--arm", required=True, help=f"which arm: {' or '.join(ARMS)}"),
)
def _replay(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where the same structure results, and 1 where it does not."""
    from learn2assemble.assembly.instructions.words import count_words
    from learn2assemble.export.robot_programs import replay_program
    from learn2assemble.handling.dry_run import SAME

    done = replay_program(options.file, options.arm)
    worst = int(done.error.argmax())
    name = done.names[worst]
    words = done.fault or ("the same structure" if done.same else "another structure")
    output.paragraph(f"{options.file.name}: {words}")
    output.say(
        f"after {done.seconds:.1f} s of motion {len(done.error)} blocks are "
        f"{1e3 * done.error.mean():.2f} mm from their places on average"
    )
    if done.brought:
        count = count_words(done.brought, "block")
        output.say(f"this arm does not move {count} of these: put where the build had them")
    far = f"{1e3 * done.error[worst]:.2f} mm (limit {1e3 * SAME:g})"
    output.paragraph(f"farthest from its place is {name}, {far}")
    output.finish(
        {
            "same": done.same,
            "fault": done.fault,
            "seconds": round(done.seconds, 3),
            "blocks": len(done.error),
            "brought": done.brought,
            "mean_error_m": round(float(done.error.mean()), 7),
            "worst_error_m": round(float(done.error[worst]), 7),
            "worst_block": worst,
            "worst_name": name,
        }
    )
    return 0 if done.same else DIFFERS
