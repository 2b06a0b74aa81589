"""Commands on structures: what an arm reaches of them, where it stands, whether they stand."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from learn2assemble.cli.parser import (
    Command,
    arg,
    command,
    friction,
    kit_argument,
    named,
    pull,
    reading_arguments,
    reading_of,
)
from learn2assemble.errors import InputError
from learn2assemble.files import UNITS, claim_folder, write_file
from learn2assemble.robot.registry import ARMS
from learn2assemble.values import rounded

if TYPE_CHECKING:
    from learn2assemble.assembly.blocks import Assembly
    from learn2assemble.cell.reach import Base
    from learn2assemble.cli.output import Output
    from learn2assemble.team.members import TeamReach
    from learn2assemble.viewer.arm import StandingArm
    from learn2assemble.viewer.page import Verdict

COMMANDS: dict[str, Command] = {}
FALLS = 1
"""Exit code of ``l2a check`` where the assembly falls."""


def _claimed(folder: Path | None) -> AbstractContextManager[None]:
    """The folder of a page, where one is asked for: claimed before any work is done."""
    return nullcontext() if folder is None else claim_folder(folder)


def _write_page(
    folder: Path | None, output: Output, assembly: Assembly, verdict: Verdict, **words: Any
) -> dict[str, str]:
    """The page of an assembly in a claimed folder, where one is asked for; the files written."""
    if folder is None:
        return {}
    from learn2assemble.viewer.page import render_assembly_page

    page = folder / "view.html"
    text = render_assembly_page(assembly, verdict=verdict, **words)
    write_file(page, text, "page")
    output.say(f"page: {page}")
    return {"page": str(page)}


@command(
    COMMANDS,
    "reach",
    "what of a design an arm reaches, and from where it reaches most",
    "l2a reach examples/designs/h.svg --arm panda --out out/reach",
    arg("design", metavar="DESIGN", help="a drawing, picture, mesh, voxels or blocks"),
    arg("--arm", action="append", required=True, help=f"{' or '.join(ARMS)}; twice for two arms"),
    arg(
        "--tool",
        default=None,
        help="suction (default), suction-side, suction-wide or gripper (default for bricks), "
        "socket, socket-large",
    ),
    kit_argument,
    reading_arguments,
    arg("--layout", type=named, default=None, metavar="FILE", help="with the base asked about"),
    arg("--out", type=named, default=None, metavar="DIR", help="write a page that shows it there"),
)
def _reach(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where everything is within reach, else 1."""
    from learn2assemble.jobs.build import reach
    from learn2assemble.team.members import TeamReach
    from learn2assemble.viewer.page import Verdict

    with _claimed(options.out):
        found = reach(
            options.design,
            arm=options.arm,
            tool=options.tool,
            kit=options.kit,
            layout=options.layout,
            **reading_of(options),
        )
        if isinstance(found, TeamReach):
            return _team_reach(found, options.out, output)
        here, best, blocks = found.here, found.best, found.assembly.blocks
        rows = [
            (
                blocks[k].id,
                blocks[k].kind,
                *(f"{rounded(v, 3):.3f}" for v in blocks[k].centroid),
                why,
            )
            for k, why in here.out.items()
        ]
        if rows:
            output.table("out of reach", ("block", "kind", "x [m]", "y [m]", "z [m]", "why"), rows)
        within = here.count - len(here.out)
        output.say(f"{found.arm} with {found.tool}: {within} of {here.count} blocks within reach")
        output.say(f"base at {here.words}")
        if best.base != here.base:
            reached = best.count - len(best.out)
            output.say(f"a base at {best.words} reaches {reached} of {best.count}")
        facts = [
            ("arm", f"{found.arm} with {found.tool}"),
            ("base", here.words),
            ("within reach", f"{within} of {here.count} blocks"),
            ("base that reaches most", best.words),
        ]
        files = _write_page(
            options.out,
            output,
            found.assembly,
            Verdict(
                "within reach" if found.complete else "out of reach",
                moving=[blocks[k].id for k in here.out],
            ),
            title=found.assembly.name or "reach",
            facts=facts,
            arms=_standing(options.out, found.assembly, [(found.arm, found.tool, here.base)]),
        )
    output.finish(
        {
            "arm": found.arm,
            "tool": found.tool,
            "base": list(here.base),
            "blocks": here.count,
            "out_of_reach": {blocks[k].id: why for k, why in here.out.items()},
            "best_base": list(best.base),
            "best_reaches": best.count - len(best.out),
            "files": files,
        }
    )
    return 0 if found.complete else 1


def _standing(
    out: Path | None, assembly: Assembly, placed: Sequence[tuple[str, str, Base]]
) -> list[StandingArm]:
    """Arms as the page shows them, where one is written: over the structure, as they wait.

    Args:
        placed: name, tool and base of each.
    """
    if out is None:
        return []
    from learn2assemble.cell.pieces import pieces_of
    from learn2assemble.cell.reach import place_arm, resting
    from learn2assemble.kinematics.approach import reached_area
    from learn2assemble.viewer.arm import StandingArm

    pieces = pieces_of(assembly)
    arms = [resting(place_arm(name, tool, at), at[3], pieces) for name, tool, at in placed]
    return [StandingArm(arm, reached_area(arm)) for arm in arms]


def _team_reach(found: TeamReach, out: Path | None, output: Output) -> int:
    """What each of several arms and both reach."""
    from learn2assemble.team.members import TOOL
    from learn2assemble.viewer.page import Verdict

    assert found.assembly is not None
    blocks = found.assembly.blocks
    rows = [
        (one.name, one.arm, reach.words, str(found.count - len(reach.out)))
        for one, reach in zip(found.arms, found.reaches, strict=True)
    ]
    output.table(f"within reach, of {found.count} blocks", ("name", "arm", "base", "blocks"), rows)
    none = [blocks[k].id for k in found.out]
    said = f"both reach {found.both}, none reaches {len(none)}"
    output.say(said)
    files = _write_page(
        out,
        output,
        found.assembly,
        Verdict("out of reach" if none else "within reach", moving=none),
        title=found.assembly.name or "reach",
        facts=[(row[0], f"{row[1]} at {row[2]}: {row[3]} blocks") for row in rows],
        arms=_standing(
            out,
            found.assembly,
            [
                (a.arm, a.tool or TOOL, r.base)
                for a, r in zip(found.arms, found.reaches, strict=True)
            ],
        ),
    )
    output.finish(
        {
            "arms": [
                {
                    "name": one.name,
                    "arm": one.arm,
                    "base": list(reach.base),
                    "out_of_reach": {blocks[k].id: why for k, why in reach.out.items()},
                }
                for one, reach in zip(found.arms, found.reaches, strict=True)
            ],
            "blocks": found.count,
            "both_reach": found.both,
            "out_of_reach": none,
            "files": files,
        }
    )
    return 1 if none else 0


@command(
    COMMANDS,
    "calibrate",
    "put base and cameras of a layout where readings say they are",
    "l2a calibrate cell.json --readings touched.json --arm ur5e",
    arg("layout", metavar="LAYOUT", type=named, help="with a base; it is written anew"),
    arg("--readings", type=named, required=True, metavar="FILE", help="see docs/sensing.md"),
    arg("--arm", default=None, help=f"of readings that are joints: {' or '.join(ARMS)}"),
    arg("--tool", default=None, help="whose tip touched: gripper (default), suction, ..."),
    arg("--out", type=named, default=None, metavar="FILE", help="write this new file instead"),
)
def _calibrate(options: argparse.Namespace, output: Output) -> int:
    from learn2assemble.acting.calibrate import calibrate

    made = calibrate(
        options.layout,
        options.readings,
        arm=options.arm,
        tool=options.tool,
        out=options.out,
    )
    found = made.found
    spreads = {"base": made.spread(0)} | {
        camera.name: made.spread(n) for n, camera in enumerate(found.cameras, 1)
    }
    rows = [
        (
            name,
            f"{1e3 * far:.2f}",
            f"{math.degrees(turned):.2f}",
            *(f"{one:.2f}" for one in spreads[name]),
            f"{sum(found.told[name])} of 6",
        )
        for name, (far, turned) in made.moved.items()
    ]
    columns = ("what", "moved [mm]", "turned [deg]", "known to [mm]", "[deg]", "coordinates read")
    output.table("calibrated", columns, rows)
    number, far = found.worst
    share = f"{found.residual:.2f} of what they may be"
    output.say(f"readings are off by {share}, reading {number} most: {far:.1f}")
    written = str(options.out or options.layout)
    output.say(f"layout: {written}")
    output.finish(
        {
            "moved": {name: list(one) for name, one in made.moved.items()},
            "known_to_mm_deg": {name: list(one) for name, one in spreads.items()},
            "told": {name: list(one) for name, one in found.told.items()},
            "residual": found.residual,
            "worst": list(found.worst),
            "files": {"layout": written},
        }
    )
    return 0


@command(
    COMMANDS,
    "check",
    "whether an assembly of blocks stands, and what moves first",
    "l2a check wall.json --out out/check",
    arg(
        "file",
        metavar="FILE",
        type=named,
        help="a plan or its folder, assembly JSON, COMPAS JSON, LDraw, brick text, meshes or a "
        "folder of them",
    ),
    arg(
        "--kit",
        default=None,
        help="of a file of bricks, whose blocks they are (lego); of others, how their joints hold",
    ),
    arg(
        "--capacity",
        type=pull,
        default=None,
        metavar="N",
        help="of a clutch, the largest pull of one contact point, instead of the kit's",
    ),
    arg("--friction", type=friction, default=None, help="instead of the file's coefficient"),
    arg("--unit", default=None, choices=tuple(UNITS), help="of meshes, which do not say it"),
    arg("--up", default=None, choices=("y", "z"), help="the axis of meshes that points up"),
    arg("--out", type=named, default=None, metavar="DIR", help="write a page with forces there"),
)
def _check(options: argparse.Namespace, output: Output) -> int:
    """Exit code 0 where it stands, if only with tight joints, else 1."""
    import numpy as np

    from learn2assemble.assembly.files import read_assembly
    from learn2assemble.assembly.instructions.appearance import unbuilt_words, unit_doubt
    from learn2assemble.statics.rigid_blocks import check
    from learn2assemble.viewer.page import Verdict

    with _claimed(options.out):
        said = {"unit": options.unit, "up": options.up}
        assembly = read_assembly(options.file, **said, kit=options.kit)
        if options.friction is not None and all(law.law == "clutch" for law in assembly.laws):
            raise InputError("friction", options.friction, "none: bricks that clutch hold without")
        if options.capacity is not None:
            assembly = assembly.with_capacity(options.capacity)
        standing = assembly.finished.blocks
        edges = np.ptp(np.concatenate([block.vertices for block in standing]), axis=0)
        size = " x ".join(f"{edge:.3g}" for edge in edges) + " m"
        output.phase(f"proving whether {len(standing)} blocks stand ({size})")
        found = check(assembly, friction=options.friction)
        held = found.margin_n is not None
        rows = [
            ("shown", found.proof),
            ("margin", f"{found.margin_g:.3f} g sideways, {found.tilt:.1f} degrees of tilt"),
            *([("margin of a contact point", f"{found.margin_n:.4g} N")] if held else []),
            ("lacking", f"{found.holding_force:.4g} N, forces and moments of all blocks added up"),
            ("moves first", ", ".join(found.moving[:8]) or "-"),
            ("blocks", unbuilt_words(assembly) or found.blocks),
            ("size", size),
            ("contacts", len(found.contacts.a)),
            ("seconds", f"{found.seconds:.2f}"),
        ]
        doubt = unit_doubt(assembly)
        rows += [("sizes", doubt)] if doubt else []
        output.table(f"{options.file.name}: {found.verdict}", ("quantity", "value"), rows)
        files = _write_page(
            options.out,
            output,
            assembly.finished,
            Verdict(found.verdict, moving=found.moving),
            title=assembly.name or options.file.stem,
            facts=[(name, str(value)) for name, value in rows],
            forces=(found.contacts, found.forces),
        )
    output.finish(
        {
            "verdict": found.verdict,
            "proof": found.proof,
            "margin_g": found.margin_g,
            "margin_n": found.margin_n,
            "tilt_deg": found.tilt,
            "holding_force": found.holding_force,
            "moves_first": list(found.moving),
            "blocks": found.blocks,
            "not_built": list(assembly.not_built),
            "contacts": len(found.contacts.a),
            "note": doubt,
            "seconds": round(found.seconds, 3),
            "files": files,
        }
    )
    return FALLS if found.verdict in ("falls", "not certain") else 0
