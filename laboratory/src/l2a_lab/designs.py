"""What the exact planner and the check reach, measured: ``results/designs.json``.

``seconds`` are of the processor, so that other programs on the machine do not count.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from l2a_lab import creep, shapes
from l2a_lab.measured import Figures, Result, by_kind
from l2a_lab.states import largest_move, states_of
from learn2assemble.assembly.blocks import Assembly, Block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.assembly.kit import Kit, load_kit, orientations
from learn2assemble.design.cells import CellDesign
from learn2assemble.design.read import read_design
from learn2assemble.errors import InputError
from learn2assemble.files import read_json_lines
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.cover.candidates import find_candidates
from learn2assemble.planning.tiling.cover.tile import Tiling, cover, seams_bridged
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import Ordering, to_assembly
from learn2assemble.statics.proofs import TIGHT

EXAMPLES, REFERENCE = Path("examples/designs"), Path("../shared/reference")
KIT, SEED, SECONDS, FRICTION = "bricks-lintels", 0, 120.0, 0.5
LARGE: dict[str, tuple[Callable[[], np.ndarray], float]] = {
    "dome of about 100 blocks": (lambda: shapes.dome(7, 2.5), 2.0),
    "house of 24x20x24 cells": (shapes.big_house, 10.0),
    "house of about 550 blocks": (
        lambda: shapes.house(
            38,
            32,
            20,
            2,
            (16, 22, 7),
            windows=(
                (4, 8, 4, 8),
                (28, 32, 4, 8),
                (4, 8, 12, 16),
                (17, 21, 12, 16),
                (28, 32, 12, 16),
            ),
        ),
        10.0,
    ),
    "tower of 16x16x40 cells": (lambda: shapes.tower(16, 16, 40, 3, 5), 30.0),
    "tower of about 1,050 blocks": (lambda: shapes.tower(20, 20, 50, 3, 5), 30.0),
    "2,000 blocks": (lambda: shapes.tower(28, 28, 64, 3, 5), 120.0),
}
"""Designs of a size, and the seconds asked for."""
DRAWN = (
    "gate.svg",
    "t.svg",
    "h.svg",
    "arch.svg",
    "circle.svg",
    "two_towers.svg",
    "figure.png",
    "dome.npy",
    "off_centre_tower.json",
    "arch_pair.json",
    "courtyard.svg",
    "gabled_house.json",
    "keep.json",
    "leaning_parallelogram.json",
    "pavilion.json",
    "pyramid.json",
    "skyline.json",
    "stepped_tower.json",
)
TIGHT_SECONDS = 600.0
"""Limit where side faces may press: a state with them takes a second."""
PREFIXES, SIMULATED = 6, 60
"""Random states of a shape that another solver judges; most blocks of one that is simulated."""


@cache
def _kit() -> Kit:
    """The kit of all shapes; a first plan with it compiles."""
    kit = load_kit(KIT)
    plan_exact(np.ones((3, 1, 2), bool), kit)
    return kit


def names() -> list[str]:
    """Every measurement: kind / design. Drawings and recorded verdicts where their files are."""
    found = [f"{kind}/{name}" for name in shapes.SHAPES for kind in ("shape", "heap", "proofs")]
    found += [f"large/{name}" for name in LARGE]
    found += [f"drawn/{name}" for name in DRAWN if EXAMPLES.is_dir()]
    found += [f"creep/{name}" for name in creep.CASES if EXAMPLES.is_dir()]
    return found + [f"check/{name}" for name, (file, _) in CHECKS.items() if file.exists()]


def configuration() -> Result:
    """Kit and limits."""
    return {"kit": KIT, "seed": SEED, "seconds_limit": SECONDS, "friction": FRICTION}


def entry(name: str) -> Result:
    """One measurement by its name."""
    kind, _, what = name.partition("/")
    if kind == "drawn":
        return drawn_entry(EXAMPLES / what)
    if kind == "check":
        file, check = CHECKS[what]
        return check(file)
    if kind == "large":
        make, asked = LARGE[what]
        return large_entry(make(), _kit(), asked)
    if kind == "creep":
        return creep.entry(what)
    measure = {"shape": shape_entry, "heap": heap_entry, "proofs": proof_entry}[kind]
    return measure(shapes.SHAPES[what](), _kit())


# ---------------------------------------------------------------- entries


def _planned(
    wanted: np.ndarray, kit: Kit, **options: Any
) -> tuple[Tiling, Ordering | None, Result]:
    """Blocks and order of a design within ``SECONDS``, and what there is to say about them."""
    started = time.process_time()
    options = {"seconds": SECONDS, **options}
    tiling, ordering = plan_exact(wanted, kit, **options)
    seconds = time.process_time() - started
    count = Counter(block.prop for block in tiling.placements)
    bridged, total = seams_bridged(tiling, kit)
    last = ordering or tiling
    steps = ordering.steps if ordering else ()
    return (
        tiling,
        ordering,
        {
            "status": last.status,
            "reason": last.reason,
            "cells": int(tiling.wanted.sum()),
            "blocks": count[False],
            "props": count[True],
            "seconds": round(seconds, 3),
            "seams": [bridged, total],
            "seams_bridged": round(bridged / max(total, 1), 4),
            "margin_g": round(ordering.margin_g, 6) if ordering else None,
            "proofs": dict(Counter(step.proof for step in steps)),
        },
    )


def shape_entry(wanted: np.ndarray, kit: Kit) -> Result:
    """Blocks, order and proof of one design; where none is found, with tight joints, too."""
    *_, result = _planned(wanted, kit, friction=FRICTION)
    if result["props"]:
        result["props_at_least"] = least_props(wanted, kit)
    if result["status"] in ("refused", "not found"):
        *_, tight = _planned(wanted, kit, seconds=TIGHT_SECONDS, friction=FRICTION, gap=0.0)
        result["gap_0"] = tight
    return result


def least_props(wanted: np.ndarray, kit: Kit) -> int:
    """A lower bound of the number of props of any plan.

    A layer that blocks carried while they are put down do not fill takes a stack of props under
    another one, from the table or the top of the structure below.
    """
    found = find_candidates(wanted, kit, flat_only=True)
    depth = np.zeros(wanted.shape, np.int64)  # empty cells straight below
    for z in range(1, wanted.shape[2]):
        depth[:, :, z] = np.where(wanted[:, :, z - 1], 0, depth[:, :, z - 1] + 1)
    depth[:, :, 0] = 0
    drop = np.where(wanted, depth, 0).reshape(-1)[found.cell]
    lowest = np.minimum.reduceat(np.where(drop > 0, drop, 10**6), found.start[:-1])
    if any(cell[2] for way in orientations(kit) for cell in way.cells):
        return 0
    least, carried = 0, found.support > 1e-9
    for z in range(wanted.shape[2]):
        level = found.origin[:, 2] == z
        must = np.flatnonzero(wanted & (np.arange(int(wanted.shape[2])) == z))
        good = found.take(np.flatnonzero(level & carried))
        filled = np.isin(must, good.cell).all()
        answer = (
            cover(good, np.zeros(len(good)), must, kit=kit)[0] if len(must) and filled else None
        )
        if len(must) and (answer is None or answer.status == "infeasible"):
            least = max(least, int(lowest[level & ~carried].min()))
    return least if least < 10**6 else 0


def heap_entry(wanted: np.ndarray, kit: Kit) -> Result:
    """The design again with exactly the blocks of its plan, props included."""
    tiling, ordering = plan_exact(wanted, kit, seconds=SECONDS)
    if (ordering or tiling).status != "complete":
        tiling = replace(tiling, placements=tuple(b for b in tiling.placements if not b.prop))
    heap = Counter(block.kind for block in tiling.placements)
    kinds = tuple(replace(kind, count=heap[kind.name]) for kind in kit.kinds)
    again, _, result = _planned(wanted, replace(kit, kinds=kinds))
    used = Counter(block.kind for block in again.placements)
    result["within_heap"] = all(used[name] <= heap[name] for name in used)
    result["filled"] = not again.missing and "lacks" not in again.reason
    return result


def proof_entry(wanted: np.ndarray, kit: Kit) -> Result:
    """Random states of the order, by another solver on other contacts, and in simulation."""
    from learn2assemble.statics.forces.equilibrium import solve
    from learn2assemble.statics.rigid_blocks import bed_patches

    tiling, ordering = plan_exact(wanted, kit, seconds=SECONDS)
    if ordering is None or ordering.status != "complete":
        return {"status": (ordering or tiling).status, "states": 0}
    assembly = to_assembly(tiling, ordering, kit)
    contacts = find_contacts(assembly)
    contacts = contacts.only(bed_patches(contacts))
    rng = np.random.default_rng(SEED)
    count = len(ordering.steps)
    chosen = sorted({*rng.integers(1, count + 1, PREFIXES - 1).tolist(), count})
    holds, moves, states = 0, list[float](), list(states_of(assembly))
    for steps in chosen:
        present = np.zeros(len(assembly.blocks), bool)
        for step in ordering.steps[:steps]:
            present[step.block] = step.place is not None
        holds += solve(assembly, contacts, FRICTION, present=present).stands
        if present.sum() <= SIMULATED:
            moves.append(round(largest_move(states[steps - 1], 1.0), 6))
    return {
        "status": "complete",
        "states": len(chosen),
        "second_solver": holds,
        "tight": sum(step.proof == TIGHT for step in ordering.steps),
        "simulated": len(moves),
        "largest_move_m": max(moves, default=0.0),
        "stood": sum(move < 0.1 * kit.pitch[2] for move in moves),
    }


def large_entry(wanted: np.ndarray, kit: Kit, asked: float) -> Result:
    """A large design with its page."""
    tiling, ordering, result = _planned(wanted, kit)
    result["seconds_asked"] = asked
    result["proof_s"] = round(ordering.seconds, 3) if ordering else None
    if ordering is not None:
        from learn2assemble.viewer.page import render_assembly_page
        from learn2assemble.viewer.tables import StepNote

        notes = [StepNote(step.proof, step.margin_g) for step in ordering.steps]
        started = time.process_time()
        made = to_assembly(tiling, ordering, kit)
        page = render_assembly_page(made, title="figures", step_notes=notes).encode()
        result["page_bytes"] = len(page)
        result["page_s"] = round(time.process_time() - started, 3)
    return result


def drawn_entry(path: Path) -> Result:
    """An example as drawn, with all files of its plan."""
    started = time.process_time()
    design = read_design(path, cell=load_kit(KIT).pitch)
    if not isinstance(design, CellDesign):
        raise InputError("design", path.name, "cells")
    plan = plan_cells(design, KIT, seconds=SECONDS)
    with tempfile.TemporaryDirectory() as folder:
        plan.save(folder)
        seconds = time.process_time() - started
        page = Path(folder) / "view.html"
        size = page.stat().st_size if page.exists() else 0
    assert plan.cells is not None
    return {
        "status": plan.status,
        "reason": plan.reason or "",
        "seconds": round(seconds, 3),
        "blocks": plan.blocks.used,
        "props": sum(step.prop and step.action == "place" for step in plan.steps),
        "cells_missing": plan.cells.missing,
        "cells_outside": plan.cells.outside,
        "page_bytes": size,
    }


def wall_entry(_: Path) -> Result:
    """The check of a wall in bond, of 1,000 blocks of 1x2."""
    wanted, kit = np.ones((50, 1, 40), bool), _kit()
    pair = replace(kit, kinds=tuple(k for k in kit.kinds if k.name in ("1x1", "1x2")))
    tiling = plan_exact(wanted, pair, seconds=SECONDS)[0]
    return _checked(to_assembly(tiling, None, pair))


def _checked(assembly: Assembly) -> Result:
    from learn2assemble.statics.rigid_blocks import check

    started = time.process_time()
    found = check(assembly)
    return {
        "verdict": found.verdict,
        "proof": found.proof,
        "margin_g": found.margin_g,
        "blocks": found.blocks,
        "seconds": round(time.process_time() - started, 3),
    }


def recorded(path: Path) -> list[tuple[Mapping[str, Any], Assembly]]:
    """The assemblies of a file of recorded verdicts, with what was said of each."""
    return [(case, _assembly(case)) for case in read_json_lines(path, "file of verdicts")]


def _assembly(case: Mapping[str, Any]) -> Assembly:
    blocks = [
        Block(str(b["id"]), b["vertices"], b["faces"], density=b["density"], support=b["support"])
        for b in case["blocks"]
    ]
    return Assembly(tuple(blocks), friction=case["friction"], name=case["name"])


def masonry_entry(path: Path) -> Result:
    """Agreement with the recorded verdicts of compas_cra."""
    from learn2assemble.statics.forces.equilibrium import solve

    started = time.perf_counter()
    rbe = coupled = wrong = 0
    cases = recorded(path)
    for case, assembly in cases:
        contacts = find_contacts(assembly)
        stands = solve(assembly, contacts).stands
        rbe += solve(assembly, contacts, coupled=False).stands == (case["rbe"] == "stands")
        coupled += stands == (case["cra"] == "stands")
        wrong += stands and case["cra"] == "falls"
    return {
        "cases": len(cases),
        "rbe_agrees": rbe,
        "cra_agrees": coupled,
        "falls_called_stands": wrong,
        "seconds": round(time.perf_counter() - started, 3),
    }


def armadillo_entry(path: Path) -> Result:
    """The check of 399 blocks with warped faces."""
    ((_, assembly),) = recorded(path)
    return _checked(assembly)


CHECKS: dict[str, tuple[Path, Callable[[Path], Result]]] = {
    "wall of 1,000 blocks": (Path(), wall_entry),
    "masonry": (REFERENCE / "masonry.jsonl.gz", masonry_entry),
    "armadillo": (REFERENCE / "masonry_armadillo.json.gz", armadillo_entry),
}
"""The file of verdicts a check is held against, and the check."""


# ---------------------------------------------------------------- in words


def summary(entries: dict[str, Result]) -> list[tuple[str, str, str]]:
    """What was asked, and what was reached: (what, asked, got)."""
    groups = by_kind(entries)
    rows: list[tuple[str, str, str]] = []

    def row(what: str, asked: str, *got: object) -> None:
        rows.append((what, asked, " ".join(map(str, got))))

    def bonded(found: dict[str, Result], what: str) -> None:
        walls = [e["seams_bridged"] for n, e in found.items() if n.startswith(("wall", "house"))]
        if walls:
            row(what, ">= 0.9", f"{min(walls):.3f} at least")

    for kind, words in (("shape", "shapes built"), ("drawn", "drawings built as drawn")):
        made = groups[kind]
        built = {n: e for n, e in made.items() if e["status"] == "complete"}
        if made:
            tight = [n for n, e in made.items() if e.get("gap_0", {}).get("status") == "complete"]
            more = f", {len(tight)} more with tight joints ({', '.join(tight)})" if tight else ""
            others = ", ".join(sorted(set(made) - set(built) - set(tight))) or "none"
            row(words, "all that can stand", f"{len(built)} of {len(made)}{more}; not: {others}")
            row(
                f"slowest ({words})",
                "< 5 s" if kind == "drawn" else "",
                f"{max(e['seconds'] for e in made.values()):.1f} s",
            )
        if made and kind == "drawn":
            wrong = sum(e["cells_missing"] + e["cells_outside"] for e in built.values())
            row("cells missing or outside on what is complete", "0", wrong)
        elif made:
            row("shapes without props", ">= 21", sum(not e["props"] for e in built.values()))
            for name, entry in built.items():
                if entry["props"]:
                    row(f"props of {name}", f">= {entry['props_at_least']} (bound)", entry["props"])
            for name, entry in made.items():
                if "gap_0" in entry:
                    tight = entry["gap_0"]
                    built = f"complete, {tight['props']} props, {tight['seconds']:.0f} s"
                    why = tight["reason"].split("; ")[-1]
                    row(
                        f"{name} with tight joints",
                        "built, or why not",
                        built if tight["status"] == "complete" else why,
                    )
            bonded(made, "seams bridged, walls and houses")
    heaps = groups["heap"]
    if heaps:
        good = sum(e["filled"] and e["within_heap"] for e in heaps.values())
        row("limited heap", f"{len(heaps)} of {len(heaps)}", f"{good} of {len(heaps)}")
        bonded(heaps, "seams bridged, walls and houses of a limited heap")
    proofs = [e for e in groups["proofs"].values() if e["states"]]
    for key, total, what in (
        ("second_solver", "states", "step proofs, second solver"),
        ("stood", "simulated", "step proofs, MuJoCo with 0.1 mm joints"),
    ):
        if proofs:
            row(what, "100 %", sum(e[key] for e in proofs), "of", sum(e[total] for e in proofs))
    for name, entry in groups["large"].items():
        row(
            name,
            f"<= {entry['seconds_asked']:g} s",
            f"{entry['seconds']:.1f} s,",
            f"{entry['status']}, {entry['blocks']} blocks, {entry['props']} props,",
            f"page {entry.get('page_bytes', 0) / 1e6:.2f} MB",
        )
    for name, entry in groups["creep"].items():
        row(
            f"MuJoCo model, {entry['seconds']:g} s: {name}",
            f"<= {1e3 * creep.LIMIT:g} mm",
            f"{entry['blocks']} blocks, {entry['props']} props,",
            "; ".join(
                f"joints of {1e3 * float(gap):g} mm: {1e3 * move:.3f} mm"
                for gap, move in entry["largest_move_m"].items()
            ),
        )
    for name, entry in groups["check"].items():
        if "cases" in entry:
            row("check: RBE agrees", "100 %", entry["rbe_agrees"], "of", entry["cases"])
            row("check: CRA agrees", ">= 60 of 62", entry["cra_agrees"], "of", entry["cases"])
            row("check: falls of CRA called stands", "0", entry["falls_called_stands"])
        else:
            row(
                f"check: {name}",
                "<= 10 s",
                f"{entry['seconds']:.1f} s,",
                f"{entry['blocks']} blocks, {entry['verdict']}",
            )
    return rows


FIGURES = Figures("learn2assemble-design-figures", names, entry, configuration, summary)
