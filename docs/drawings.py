"""Drawings at the top of pages, made when the documents are built.

This hook of mkdocs puts a drawing below the title of every page of :data:`PAGES`: one of
:data:`DRAWINGS`, from what the library computes or the result files hold, or a picture of the
gallery. ``python docs/drawings.py [NAME ...]`` writes them into ``out/drawings``.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

ROOT = Path(__file__).resolve().parents[1]
INK, SOFT, LINE, FILL, ACCENT, WARM = (
    *("#2b2f36", "#6b7280", "#c9cdd4", "#eef1f4"),
    *("#0b7285", "#d9480f"),
)
mpl.rcParams |= {"svg.hashsalt": "learn2assemble", "svg.fonttype": "none", "font.size": 10}
Draw = Callable[[], Figure]
SUITE = (
    ("two elevations", r"two-sided-", ACCENT),
    ("with a robot", r"robot-", INK),
    ("tight heaps", r"designs-.*-heap-", WARM),
    ("hidden errors", r"hidden-", LINE),
)
"""Tasks of the benchmark that are drawn: name, how their names begin, colour."""


def _panel(width: float = 8.0, height: float = 2.6) -> tuple[Figure, Axes]:
    """An empty drawing [inch], whose units are its own."""
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.axis("off")
    return figure, axes


def _chart(width: float = 8.0, height: float = 3.0, count: int = 1) -> tuple[Figure, Axes]:
    """A drawing with axes, one below the other where there are several; the first of them."""
    figure = Figure(figsize=(width, height), layout="constrained")
    for axes in figure.subplots(count, 1, squeeze=False, height_ratios=(2, 1, 1)[:count]).flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.spines[["left", "bottom"]].set_color(LINE)
        axes.tick_params(colors=SOFT)
    return figure, figure.axes[0]


def _box(axes: Axes, x: float, y: float, words: str, width: float = 1.5, tone: str = FILL) -> None:
    """A box with words in its middle."""
    style = {"boxstyle": "round,pad=0.05", "linewidth": 1.1, "edgecolor": INK, "facecolor": tone}
    axes.add_patch(FancyBboxPatch((x - width / 2, y - 0.32), width, 0.64, **style))
    axes.text(x, y, words, ha="center", va="center", color=INK, linespacing=1.2)


def _arrow(axes: Axes, tail: Any, head: Any, words: str = "", tone: str = INK) -> None:
    how = {"arrowstyle": "-|>", "color": tone, "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", head, tail, arrowprops=how)
    if words:
        x, y = (np.asarray(tail) + np.asarray(head)) / 2
        axes.text(x, y + 0.1, words, ha="center", color=SOFT, fontsize=9)


def flow() -> Figure:
    """The way of a design."""
    figure, axes = _panel(10, 2.2)
    names = "drawing,\nmodel, blocks", "cells", "blocks\nof a kit", "order with\nproof", "arm"
    xs = np.linspace(1.0, 9.0, len(names))
    for k, (x, name) in enumerate(zip(xs, names, strict=True)):
        _box(axes, x, 1.3, name, 1.35, "#dff0f2" if k == 3 else FILL)
        if k:
            _arrow(axes, (xs[k - 1] + 0.75, 1.3), (x - 0.75, 1.3))
    for x, words in ((xs[3], "page, cards, files"), (xs[4], "program of a robot")):
        axes.text(x, 0.55, words, ha="center", color=SOFT, fontsize=9)
    return figure


def rooms() -> Figure:
    """Two wings and a laboratory; imports point down."""
    figure, axes = _panel(10, 3.4)
    rows = (
        (2.9, ("command line", "public face"), 4.6),
        (
            2.1,
            ("the paper's wing:\ntasks, environments", "viewer, exports", "jobs, cell of an arm"),
            3.0,
        ),
        (1.3, ("planning", "simulation, sensing", "controllers"), 3.0),
        (0.5, ("design", "statics", "robot, motion", "geometry, blocks"), 2.2),
    )
    for y, names, width in rows:
        xs = np.linspace(0.3 + width / 2, 9.7 - width / 2, len(names))
        for x, name in zip(xs, names, strict=True):
            _box(axes, x, y, name, width, "#fdf0e6" if "paper" in name else FILL)
    return figure


def proof() -> Figure:
    """Three bricks with the forces in their joints, standing and falling."""
    figure, axes = _panel(9, 3.9)
    for left, step, tone in ((0.6, 0.06, ACCENT), (5.1, 0.08, WARM)):
        scale, load, floor = 8.0, 0.22, 1.1
        axes.plot([left - 0.3, left + 3.1], [floor, floor], color=INK, lw=1.2)
        for k in range(3):
            corner = (left + scale * step * k, floor + 0.8 * k)
            axes.add_patch(Rectangle(corner, 1.6, 0.8, fc=FILL, ec=INK, lw=1.1))
            axes.text(corner[0] + 0.8, corner[1] + 0.4, "W", ha="center", va="center", color=SOFT)
            # The blocks from this one up act on its lower joint.
            above = range(k, 3)
            at = float(np.mean([step * j + 0.1 for j in above]))
            start, end = step * k, (step * (k - 1) if k else 0.0) + 0.2
            right = len(above) * (at - start) / (end - start)
            for x, force in ((start, len(above) - right), (end, right)):
                foot = (left + scale * x, corner[1])
                if force < 0:
                    axes.plot(*foot, "x", color=WARM, ms=12, mew=2.5)
                else:
                    _arrow(axes, (foot[0], foot[1] - load * force), foot, tone=tone)
        words = "6 cm: forces that press" if tone == ACCENT else "8 cm: a joint would have to pull"
        axes.text(left + 1.4, 0.15, words, ha="center", color=tone)
    return figure


def _cells(axes: Axes, cells: Any, at: Any, size: float, tone: str = "#dff0f2") -> None:
    """Cells of a lattice (x, y, z), seen from the front, the right and above."""
    across, deep, up = size * np.array([[1, 0], [0.45, 0.41], [0, 1.45]])
    for x, y, z in sorted(cells, key=lambda cell: (-cell[1], cell[2], cell[0])):
        corner = at + x * across + y * deep + z * up
        for a, b, off, shade in (
            (across, up, 0 * up, tone),
            (across, deep, up, "white"),
            (up, deep, across, FILL),
        ):
            face = [corner + off, corner + off + a, corner + off + a + b, corner + off + b]
            axes.add_patch(Polygon(face, fc=shade, ec=INK, lw=0.6))


def kits() -> Figure:
    """Kinds of two kits of the package, each as the cells it takes."""
    from learn2assemble.assembly.kit import load_kit

    (figure, axes), size = _panel(10, 2.7), 0.15
    for y, name in ((1.75, "bricks-lintels"), (0.5, "tetrominoes")):
        axes.text(0.3, y + 0.78, name, color=SOFT)
        left = 0.3
        for kind in load_kit(name).kinds:
            colour = kind.colour or (223, 240, 242)
            _cells(axes, kind.cells, (left, y), size, "#{:02x}{:02x}{:02x}".format(*colour))
            wide, deep, _ = np.max(kind.cells, 0) + 1
            middle = left + 0.5 * size * wide
            axes.text(middle, y - 0.24, kind.name, ha="center", color=SOFT, fontsize=8)
            left += size * (wide + 0.45 * deep) + 0.12
    return figure


def sides() -> Figure:
    """Elevations, what is to be seen from two sides, and the lattice between them."""
    figure, axes = _panel(9, 3.0)
    front = np.array([[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 0, 0, 0, 1]])[::-1]
    side = np.array([[0, 1, 0], [1, 1, 1], [1, 1, 1]])[::-1]
    for left, cells, name in ((0.5, front, "front"), (6.3, side, "left")):
        for (z, x), filled in np.ndenumerate(cells):
            tone = "#dff0f2" if filled else "white"
            axes.add_patch(Rectangle((left + 0.5 * x, 0.6 + 0.5 * z), 0.5, 0.5, fc=tone, ec=LINE))
        axes.text(left + 0.25 * cells.shape[1], 0.25, name, ha="center", color=SOFT)
    _arrow(axes, (3.4, 1.3), (4.0, 1.3))
    _arrow(axes, (6.0, 1.3), (5.4, 1.3))
    cells = [(x, y, z) for z, x in np.argwhere(front) for y in range(3) if side[z, y]]
    _cells(axes, cells, (4.15, 0.75), 0.22)
    return figure


@cache
def _record() -> Any:
    """What the Panda of the gallery did."""
    import learn2assemble as l2a

    return l2a.load_plan(ROOT / "out" / "gallery" / "panda").record


def attempt() -> Figure:
    """Height and speed of the tool in the first attempts of a build of the gallery."""
    from learn2assemble.kinematics.shape import arm_shape
    from learn2assemble.robot.arm import get_arm

    shape, steps = arm_shape(get_arm("panda")), _record().steps[:3]
    figure, axes = _chart()
    for number, step in enumerate(steps):
        height = [1e3 * shape.tool(q)[0][2] for q in step.samples.joints]
        axes.plot(step.samples.time, height, color=ACCENT, lw=1.6)
        for k, stage in enumerate(step.stages):
            axes.axvspan(stage.start, stage.end, color=FILL if k % 2 else "white", lw=0)
            if not number:
                middle = (stage.start + stage.end) / 2
                axes.text(middle, 10, stage.name, rotation=90, ha="center", color=SOFT, fontsize=8)
    axes.set_xlabel("time [s]", color=SOFT)
    axes.set_ylabel("height of the tool [mm]", color=SOFT)
    axes.set_xlim(0, steps[-1].samples.time[-1])
    axes.set_ylim(bottom=0)
    return figure


def speeds() -> Figure:
    """Speeds of the joints as shares of their limits."""
    record = _record()
    figure, axes = _chart()
    for step in record.steps[:3]:
        share = step.samples.velocity / record.arm.velocity
        for joint, tone in zip(
            share.T, mpl.colormaps["viridis"](np.linspace(0, 0.9, 7)), strict=True
        ):
            axes.plot(step.samples.time, joint, color=tone, lw=1)
    for bound in (-1, 1):
        axes.axhline(bound, color=WARM, lw=1.2, ls="--")
    axes.set_xlabel("time [s]", color=SOFT)
    axes.set_ylabel("speed of joints / limit", color=SOFT)
    axes.set_xlim(0, step.samples.time[-1])
    return figure


def layout() -> Figure:
    """From above: base, blocks that wait, and the site, of a build of the gallery."""
    record = _record()
    figure, axes = _chart(6, 3.8)
    first, last = record.steps[0].before[:, :2], record.steps[-1].after[:, :2]
    for places, tone, name in ((first, WARM, "wait"), (last, ACCENT, "built")):
        axes.scatter(*places.T, marker="s", s=90, fc="none", ec=tone, label=name)
    base = record.arm.base_position[:2]
    axes.scatter(*base, s=420, c=INK)
    axes.text(base[0], base[1], "base", ha="center", va="center", color="white", fontsize=8)
    axes.legend(frameon=False, labelcolor=INK)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]", color=SOFT)
    axes.set_ylabel("y [m]", color=SOFT)
    return figure


def camera() -> Figure:
    """A camera sees a block: points, pose, how sure."""
    figure, axes = _panel(9, 2.8)
    axes.plot([0.3, 8.7], [0.5, 0.5], color=INK, lw=1.2)
    axes.add_patch(Rectangle((2.6, 0.5), 1.2, 0.6, fc=FILL, ec=INK))
    eye = np.array([0.9, 2.3])
    axes.add_patch(Polygon([(0.9, 2.3), (1.2, 2.4), (1.0, 1.98)], fc=INK))
    rng = np.random.default_rng(0)
    top = np.stack([np.linspace(2.62, 3.78, 12), np.full(12, 1.1)], -1)
    face = np.stack([np.full(6, 2.6), np.linspace(0.55, 1.05, 6)], -1)
    for point in np.concatenate([top, face]) + rng.normal(0, 0.02, (18, 2)):
        axes.plot(*np.stack([eye, point]).T, color=LINE, lw=0.5)
        axes.plot(*point, ".", color=ACCENT)
    _arrow(axes, (4.2, 1.2), (5.0, 1.2))
    axes.text(5.2, 1.45, "pose of the block", color=INK)
    axes.text(5.2, 1.1, "covariance: what the pictures", color=SOFT)
    axes.text(5.2, 0.8, "do not tell stays uncertain", color=SOFT)
    axes.text(0.3, 2.6, "depth camera", color=SOFT)
    return figure


def wall() -> Figure:
    """What decides, and what senses and moves."""
    figure, axes = _panel(9, 2.4)
    _box(axes, 1.6, 1.2, "plan, belief,\nnext attempt", 2.2)
    _box(axes, 7.4, 1.2, "plant: simulated cell\nor robot", 2.6)
    axes.plot([4.4, 4.4], [0.2, 2.2], color=WARM, lw=2)
    axes.text(4.5, 0.15, "nothing else passes", color=WARM, fontsize=9)
    _arrow(axes, (2.8, 1.45), (6.0, 1.45), "motions until a guard ends them")
    _arrow(axes, (6.0, 0.95), (2.8, 0.95), "poses, joints, what the tool feels")
    return figure


def _scores() -> dict[str, list[float]]:
    """Mean score of every entry of the benchmark on each of :data:`SUITE`."""
    found: dict[str, list[float]] = {}
    for file in sorted((ROOT / "results" / "benchmark").glob("*.jsonl.gz")):
        head, *lines = map(json.loads, gzip.decompress(file.read_bytes()).splitlines())
        scores = [
            [one["score"] for one in lines if re.match(form, one["task"])] for _, form, _ in SUITE
        ]
        found[head["entry"]] = [float(np.mean(s)) if s else np.nan for s in scores]
    return found


def board() -> Figure:
    """The board as bars: ``docs/images/benchmark.svg``, which the first page shows."""
    figure, axes = _chart(6.4, 5.4)
    _bars(axes)
    return figure


def scores() -> Figure:
    """The board as bars, and how the baselines that train on the spot learn."""
    figure, axes = _chart(9, 11, 3)
    _bars(axes)
    _curves(figure.axes[1])
    _builders(figure.axes[2])
    return figure


def _bars(axes: Axes) -> None:
    """A bar for every entry and kind of task."""
    found = _scores()
    for k, (name, _, tone) in enumerate(SUITE):
        values = [one[k] for one in found.values()]
        axes.barh(np.arange(len(values)) + 0.2 * (1.5 - k), values, 0.19, color=tone, label=name)
    axes.set_yticks(range(len(found)), list(found))
    axes.set_xlim(-0.2, 1.05)
    axes.set_xlabel("share of the bound", color=SOFT)
    axes.legend(frameon=False, labelcolor=INK, loc="upper right", bbox_to_anchor=(1.0, 1.1), ncol=4)


def _curves(axes: Axes) -> None:
    """Returns of MaskablePPO and of DQN (broken lines) while they train, of every task and seed."""
    with (ROOT / "results" / "benchmark" / "curves.csv").open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    tasks = dict.fromkeys(one["task"] for one in lines)
    tones = (WARM, INK, ACCENT, SOFT, LINE, "#7048e8", "#2b8a3e", "#e8590c", "#d6336c", "#a98467")
    tone = dict(zip(tasks, tones[: len(tasks)], strict=True))
    named = set[str]()
    for entry, task, seed in dict.fromkeys((r["entry"], r["task"], r["seed"]) for r in lines):
        mine = [r for r in lines if (r["entry"], r["task"], r["seed"]) == (entry, task, seed)]
        told = [(int(r["steps"]), float(r["return"])) for r in mine]
        style = {"ls": "-" if entry == "MaskablePPO" else "--"}
        name = {} if task in named else {"label": task}
        named.add(task)
        axes.plot(*np.transpose(told), color=tone[task], lw=0.9, alpha=0.7, **style, **name)
    axes.set_xlabel("steps of training, MaskablePPO (lines) and DQN (broken lines)", color=SOFT)
    axes.set_ylabel("return, not discounted", color=SOFT)
    axes.legend(frameon=False, labelcolor=INK, fontsize=8, loc="upper left", bbox_to_anchor=(1, 1))


def _builders(axes: Axes) -> None:
    """How often the likeliest candidate of the builders is right while they train, by seed."""
    with (ROOT / "agents" / "builders" / "curves.csv").open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    for name in sorted({one["builder"] for one in lines}):
        own = "search" in name
        told = [(float(r["seconds"]), float(r["right"])) for r in lines if r["builder"] == name]
        words = "of its own search" if own else "of the exact planner"
        label = {"label": f"with solutions {words}"} if name.endswith("-s1") else {}
        axes.plot(*np.transpose(told), color=WARM if own else ACCENT, lw=0.9, alpha=0.8, **label)
    axes.set_xlabel("seconds of the processor, builder of designs, five seeds", color=SOFT)
    axes.set_ylabel("share of right choices", color=SOFT)
    axes.legend(frameon=False, labelcolor=INK, fontsize=8)


def tables() -> Figure:
    """R of table T2 beside the paper's, with 95 % intervals."""
    with (ROOT / "results" / "tables.csv").open(encoding="utf-8") as stream:
        lines = [one for one in csv.DictReader(stream) if one["table"] == "T2"]
    task = "two-sided-3x3-20-24"
    rows = [r for r in lines if (r["task"], r["epsilon"]) == (task, "0.05") and r["paper_R_ci95"]]
    figure, axes = _chart(8, 3.4)
    for k, (name, key, tone) in enumerate((("paper", "paper_R", SOFT), ("here", "R", ACCENT))):
        middle = [float(row[key]) for row in rows]
        spread = [float(row[f"{key}_ci95"]) for row in rows]
        at = np.arange(len(rows)) + 0.15 - 0.3 * k
        axes.errorbar(middle, at, xerr=spread, fmt="o", color=tone, capsize=3, label=name)
    axes.set_yticks(range(len(rows)), [row["method"] for row in rows])
    axes.invert_yaxis()
    axes.set_xlabel(f"return R, {task}, ε = 0.05", color=SOFT)
    axes.legend(frameon=False, labelcolor=INK)
    return figure


def graph() -> Figure:
    """Blocks and targets as nodes, and the placements that are scored."""
    figure, axes = _panel(9, 3.0)
    targets = [(0.9 + 0.6 * k, 2.5) for k in range(4)]
    placed = [(1.2, 1.1), (1.8, 1.1), (1.8, 1.6)]
    waiting = [(5.2 + 0.6 * k, 0.5) for k in range(4)]
    for nodes, tone, words, x in (
        (targets, LINE, "targets", 3.6),
        (placed, ACCENT, "placed", 2.75),
        (waiting, WARM, "waiting", 7.6),
    ):
        for a in nodes:
            for b in nodes:
                axes.plot(*np.transpose([a, b]), color=LINE, lw=0.6, zorder=0)
            axes.scatter(*a, s=150, c=tone, ec=INK, zorder=2)
        axes.text(x, nodes[0][1] - 0.05, words, color=SOFT)
    for a in targets:
        for b in placed:
            axes.plot(*np.transpose([a, b]), color=LINE, lw=0.4, zorder=0)
    for spot, value in (((1.2, 1.6), "4.1"), ((2.4, 1.1), "2.7"), ((0.6, 1.1), "2.2")):
        axes.add_patch(Rectangle((spot[0] - 0.18, spot[1] - 0.18), 0.36, 0.36, fc="none", ec=WARM))
        axes.text(*spot, value, ha="center", va="center", fontsize=8, color=WARM)
    _arrow(axes, (5.0, 0.75), (2.6, 0.95), tone=WARM)
    axes.text(3.3, 0.45, "Q of every placement", color=WARM, fontsize=9)
    return figure


def tree() -> Figure:
    """A small tree of placements before every decision."""
    figure, axes = _panel(9, 2.9)
    levels = {(4.5, 2.4): [2.2, 4.5, 6.8], (2.2, 1.45): [1.5, 2.9], (4.5, 1.45): [3.8, 5.2]}
    for (x, y), children in levels.items():
        for child in children:
            best = (x, child) in ((4.5, 4.5), (4.5, 5.2))
            tone = WARM if best else LINE
            axes.plot([x, child], [y, y - 0.95], color=tone, lw=2.4 if best else 1.2, zorder=0)
            axes.scatter(child, y - 0.95, s=170, c=FILL, ec=INK)
    axes.scatter(4.5, 2.4, s=230, c=ACCENT, ec=INK)
    axes.text(4.8, 2.45, "state now", color=SOFT)
    axes.text(7.1, 1.4, "what placements bring,\nby the exact model", color=SOFT)
    axes.text(5.5, 0.42, "Q where the tree ends", color=SOFT)
    return figure


def learning() -> Figure:
    """Returns while DQN learns, of five agents, with the paper's."""
    lines = gzip.decompress((ROOT / "results" / "runs.jsonl.gz").read_bytes()).splitlines()
    runs = [run for run in map(json.loads, lines) if run["name"].startswith("dqn-s")]
    figure, axes = _chart()
    for run in runs:
        told = [(one["samples"], one["R"]) for one in run["log"] if one.get("R") is not None]
        axes.plot(*np.transpose(told), color=ACCENT, lw=0.9, alpha=0.7)
    axes.axhline(3.21, color=WARM, ls="--", lw=1.2)
    axes.text(0, 3.25, "paper, DQN without a search", color=WARM, fontsize=9)
    axes.set_xlabel("samples", color=SOFT)
    axes.set_ylabel("return R", color=SOFT)
    return figure


DRAWINGS: dict[str, Draw] = {
    draw.__name__: draw
    for draw in (flow, rooms, proof, sides, kits, attempt, speeds, layout, camera, wall, scores)
} | {draw.__name__: draw for draw in (tables, graph, tree, learning, board)}
PAGES = {
    "architecture.md": ("rooms", "The rooms of the code; imports point down"),
    "arms.md": ("gallery/panda", "What a Panda has built"),
    "benchmark.md": (
        "scores",
        "Share of the bound by entry: two elevations, the same with a robot, tight heaps, hidden "
        "errors; returns of MaskablePPO",
    ),
    "bricks.md": ("gallery/lego_dome", "A hollow dome of LEGO"),
    "building.md": ("gallery/house", "A gabled house of bricks and lintels"),
    "check.md": ("gallery/stones", "Stones that stand on edges and points, too"),
    "commands.md": ("flow", "From a drawing to a robot"),
    "design_files.md": ("sides", "Two elevations and the blocks that fill them"),
    "curves.md": ("learning", "Returns of five agents of DQN while they learn"),
    "deviations.md": ("learning", "Returns of five agents of DQN while they learn"),
    "gallery.md": ("gallery/turned_wall", "A wall of turned bricks"),
    "from_lego.md": ("gallery/lego_tower", "A tower of bricks, from an LDraw file"),
    "from_rhino.md": ("gallery/arch", "An arch, and the posts that carry it for a while"),
    "given_blocks.md": ("gallery/stair", "Steps of a stair, each proven as it comes"),
    "goals.md": ("gallery/goals", "A structure that was invented for its goals"),
    "howto.md": ("gallery/soma", "A puzzle from a kit of one's own"),
    "instructions.md": ("gallery/lego_tower", "A tower of bricks"),
    "kits.md": ("kits", "Kinds of two kits, by name"),
    "layouts.md": ("layout", "Base, blocks that wait, and the site, from above"),
    "methods/builder.md": ("gallery/gate", "A gate of bricks and two lintels"),
    "methods/dqn.md": ("learning", "Returns of five agents of DQN while they learn"),
    "methods/relational.md": ("graph", "Nodes of the graph, and the placements that are scored"),
    "methods/search.md": ("tree", "A small tree before every decision"),
    "plan.md": ("gallery/arch", "An arch on posts, a plan of 21 blocks"),
    "proof.md": ("proof", "Three bricks: forces that press, and a joint that would have to pull"),
    "reference.md": ("rooms", "The rooms of the code"),
    "results.md": ("tables", "Returns of table T2 beside the paper's"),
    "robot_programs.md": ("speeds", "Speeds of the joints within their limits"),
    "run.md": ("wall", "What decides, and the plant that senses and moves"),
    "sensing.md": ("camera", "A depth camera tells a pose and how sure it is"),
    "tables.md": ("tables", "Returns of table T2 beside the paper's"),
    "trajectory.md": ("attempt", "Height of the tool in three attempts, with their stages"),
    "two_arms.md": ("gallery/two_arms", "A Panda and a UR5e build a pyramid at the same time"),
    "with_arm.md": ("gallery/panda", "A Panda puts a block down"),
    "tutorial.md": ("gallery/gate", "The gate of the tutorial"),
}
"""The picture of a page, and what a reader who does not see it is told."""


def svg(name: str) -> bytes:
    """A drawing."""
    content = io.BytesIO()
    DRAWINGS[name]().savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue()


def on_files(files: Any, config: Any) -> Any:
    """Hook of mkdocs: the drawings are files of the site (those of the gallery are there)."""
    from mkdocs.structure.files import File

    for name in {one for one, _ in PAGES.values()} & set(DRAWINGS):
        files.append(File.generated(config, f"drawings/{name}.svg", content=svg(name)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Hook of mkdocs: the drawing stands below the title."""
    place = page.file.src_uri
    if place not in PAGES:
        return markdown
    name, words = PAGES[place]
    file = f"{name}.png" if name.startswith("gallery/") else f"drawings/{name}.svg"
    # What comes before the title is the style of a page that was made.
    before, title, rest = re.split(r"^(# .*)$", markdown, maxsplit=1, flags=re.MULTILINE)
    return (
        f"{before}{title}\n\n![{words}]({'../' * place.count('/')}{file}){{ width=560 }}\n\n{rest}"
    )


if __name__ == "__main__":
    folder = ROOT / "out" / "drawings"
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or DRAWINGS:
        (folder / f"{name}.svg").write_bytes(svg(name))
