"""Commands on what was built: whether it stands, files of other programs, dry runs of robots."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.parser import Command, number
from learn2assemble.errors import InputError, look_up
from learn2assemble.files import claim_folder, write_file
from learn2assemble.robot.registry import ARMS

if TYPE_CHECKING:
    from learn2assemble.cli.output import Output

FALLS = 1
"""Exit code of ``l2a check`` where the assembly falls."""
DIFFERS = 1
"""Exit code of ``l2a replay-trajectory`` where another structure results."""
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}


def length(text: str) -> float:
    """A length with its unit, ``0.5mm`` or ``3 cm``; a bare number is metres."""
    body = text.strip()
    for unit in ("mm", "cm", "in", "m"):
        if body.endswith(unit):
            body, scale = body.removesuffix(unit), _UNITS[unit]
            break
    else:
        scale = 1.0
    try:
        value = float(body) * scale
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a length such as 0.5mm")
    return value


def span_of(parse: Any) -> Any:
    """An argparse type for one value or a range of two, ``LOW:HIGH``.

    A unit may stand behind the last only: ``0:0.5mm``.
    """

    def parse_span(text: str) -> Any:
        low, colon, high = text.partition(":")
        if not colon:
            return parse(low)
        unit = high.lstrip("0123456789.+-eE ") if parse is length else ""
        first = parse(low if low.endswith(unit) else low + unit)
        second = parse(high)
        if first > second:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected LOW:HIGH")
        return first, second

    return parse_span


friction = number(float, 0, 10, "a coefficient of friction from 0 to 10")


def _check_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="assembly JSON, COMPAS JSON, meshes or a folder")
    add("--friction", type=friction, default=None, help="instead of the file's coefficient")
    add("--unit", default="m", choices=tuple(_UNITS), help="of the coordinates in meshes")
    add("--out", type=Path, default=None, metavar="DIR", help="write a page with the forces there")


def _check(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where it stands, if only with tight joints, and 1 where it falls."""
    from learn2assemble.assembly.files import read_assembly
    from learn2assemble.physics.rigid_blocks import check

    assembly = read_assembly(options.file, unit=_UNITS[options.unit])
    found = check(assembly, friction=options.friction)
    rows = [
        ("shown", found.proof),
        ("margin", f"{found.margin_g:.3f} g sideways, {found.tilt:.1f} degrees of tilt"),
        ("holding force", f"{found.holding_force:.4g} N"),
        ("moves first", ", ".join(found.moving[:8]) or "-"),
        ("blocks", found.blocks), ("contacts", len(found.contacts.a)),
        ("seconds", f"{found.seconds:.2f}"),
    ]  # fmt: skip
    output.table(f"{options.file.name}: {found.verdict}", ("quantity", "value"), rows)
    files: dict[str, str] = {}
    if options.out is not None:
        from learn2assemble.viewer.page import render_assembly_page

        with claim_folder(options.out):
            page = options.out / "view.html"
            text = render_assembly_page(
                assembly.finished, title=assembly.name or options.file.stem,
                facts=[(name, str(value)) for name, value in rows], moving=found.moving,
                forces=(found.contacts, found.forces), status=found.verdict,
            )  # fmt: skip
            write_file(page, text, "page")
        files["page"] = str(page)
        output.say(f"page: {page}")
    output.finish({
        "verdict": found.verdict, "proof": found.proof,
        "margin_g": found.margin_g, "tilt_deg": found.tilt,
        "holding_force": found.holding_force, "moves_first": list(found.moving),
        "blocks": found.blocks, "contacts": len(found.contacts.a),
        "seconds": round(found.seconds, 3), "files": files,
    })  # fmt: skip
    return FALLS if found.verdict == "falls" else 0


def _export_arguments(parser: argparse.ArgumentParser) -> None:
    from learn2assemble.export import PROGRAM_FORMATS
    from learn2assemble.export.formats import FORMATS

    add = parser.add_argument
    add("plan", metavar="PLAN", type=Path, help="folder of a plan, its plan.json, or an assembly")
    add(
        "--format", required=True,
        help=f"{', '.join(FORMATS)}; of a build with an arm: {', '.join(PROGRAM_FORMATS)}",
    )  # fmt: skip
    add("--out", type=Path, default=Path(), metavar="PATH", help="file or folder (here)")


def _export(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.assembly.files import read_assembly
    from learn2assemble.export import PROGRAM_FORMATS
    from learn2assemble.export.formats import FORMATS, export_assembly

    if options.format in PROGRAM_FORMATS:
        return _export_program(options, output)
    # A wrong name is refused before anything is read.
    look_up("format", options.format, {**FORMATS, **dict.fromkeys(PROGRAM_FORMATS)})
    path: Path = options.plan
    if path.is_dir():
        path = path / "assembly.json"
    elif path.name == "plan.json":
        path = path.with_name("assembly.json")
    if not path.exists():
        expected = "a plan that l2a build made without an arm, or an assembly"
        raise InputError("PLAN", str(options.plan), expected)
    written = export_assembly(read_assembly(path), options.format, options.out)
    output.say(f"{options.format}: {written}")
    output.finish({"format": options.format, "file": str(written)})


def _export_program(options: argparse.Namespace, output: Output) -> None:
    from learn2assemble.export.robot_programs import export_program

    done = export_program(options.plan, options.format, options.out)
    used = ", ".join(f"{name} {100 * share:.0f} %" for name, share in done.used.items())
    output.say(
        f"{options.format}: {done.file}, {done.seconds:.1f} s, of the limits at most {used}, "
        f"time stretched by {done.stretch:.3f} at most"
    )
    output.finish({
        "format": options.format, "file": str(done.file), "seconds": round(done.seconds, 3),
        "stretch": round(done.stretch, 6),
        "used": {name: round(share, 6) for name, share in done.used.items()},
    })  # fmt: skip


def _replay_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="what l2a export has written as csv, franka, ros2")
    add("--arm", required=True, help=f"which arm: {' or '.join(ARMS)}")


def _replay(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where the same structure results, and 1 where it does not."""
    from learn2assemble.export.robot_programs import replay_program
    from learn2assemble.robot.motion.program import SAME

    done = replay_program(options.file, options.arm)
    worst = int(done.error.argmax())
    words = done.fault or ("the same structure" if done.same else "another structure")
    output.say(
        f"{options.file.name}: {words}, after {done.seconds:.1f} s of motion {len(done.error)} "
        f"blocks are {1e3 * done.error.mean():.2f} mm from where they should be on average, block "
        f"{worst} {1e3 * done.error[worst]:.2f} mm (limit {1e3 * SAME:g})"
    )
    output.finish({
        "same": done.same, "fault": done.fault, "seconds": round(done.seconds, 3),
        "blocks": len(done.error),
        "mean_error_m": round(float(done.error.mean()), 7),
        "worst_error_m": round(float(done.error[worst]), 7), "worst_block": worst,
    })  # fmt: skip
    return 0 if done.same else DIFFERS


def _reach_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("design", metavar="DESIGN", help="a drawing, picture, mesh, voxels or blocks")
    add("--arm", required=True, help=" or ".join(ARMS))
    add("--tool", default="suction", help="suction (default), suction-side or gripper")
    add("--kit", default=None, help="name or .toml file (the design's own)")
    add("--unit", default=None, help="of the file where it does not say: mm, cm, m")
    add("--layout", type=Path, default=None, metavar="FILE", help="with the base asked about")
    add("--out", type=Path, default=None, metavar="DIR", help="write a page that shows it there")


def _reach(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where everything is within reach, else 1."""
    from learn2assemble.planning.build import reach

    reading = {} if options.unit is None else {"unit": options.unit}
    found = reach(
        options.design, arm=options.arm, tool=options.tool, kit=options.kit,
        layout=options.layout, reading=reading,
    )  # fmt: skip
    here, best, blocks = found.here, found.best, found.assembly.blocks
    rows = [(blocks[k].id, blocks[k].kind, *(f"{v:.3f}" for v in blocks[k].centroid), why)
            for k, why in here.out.items()]  # fmt: skip
    if rows:
        output.table("out of reach", ("block", "kind", "x [m]", "y [m]", "z [m]", "why"), rows)
    within = here.count - len(here.out)
    output.say(f"{found.arm} with {found.tool} at {here.words}: {within} of {here.count} blocks")
    if best.base != here.base:
        reached = best.count - len(best.out)
        output.say(f"a base at {best.words} reaches {reached} of {best.count}")
    files: dict[str, str] = {}
    if options.out is not None:
        from learn2assemble.viewer.page import render_assembly_page

        with claim_folder(options.out):
            page = options.out / "view.html"
            facts = [("arm", f"{found.arm} with {found.tool}"), ("base", here.words),
                     ("within reach", f"{within} of {here.count} blocks"),
                     ("base that reaches most", best.words)]  # fmt: skip
            text = render_assembly_page(
                found.assembly, title=found.assembly.name or "reach", facts=facts,
                moving=[blocks[k].id for k in here.out],
                status="within reach" if found.complete else "out of reach",
            )  # fmt: skip
            write_file(page, text, "page")
        files["page"] = str(page)
        output.say(f"page: {page}")
    output.finish({
        "arm": found.arm, "tool": found.tool, "base": list(here.base), "blocks": here.count,
        "out_of_reach": {blocks[k].id: why for k, why in here.out.items()},
        "best_base": list(best.base), "best_reaches": best.count - len(best.out), "files": files,
    })  # fmt: skip
    return 0 if found.complete else 1


COMMANDS = {
    "reach": Command(
        "what of a design an arm reaches, and from where it reaches most",
        "l2a reach examples/designs/h.svg --arm panda --out out/reach", _reach_arguments, _reach,
    ),
    "check": Command(
        "whether an assembly of blocks stands, and what moves first",
        "l2a check wall.json --out out/check", _check_arguments, _check,
    ),
    "export": Command(
        "a plan as GLB, MJCF, COMPAS, bill of blocks or step cards, or as program of a robot",
        "l2a export out/house --format glb", _export_arguments, _export,
    ),
    "replay-trajectory": Command(
        "play an exported program of a robot in the simulation, without looking",
        "l2a replay-trajectory out/program.csv --arm panda", _replay_arguments, _replay,
    ),
}  # fmt: skip
