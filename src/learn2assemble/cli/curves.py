"""``l2a curves``: learning curves of the committed runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.reproduction.curves import get_figure, load_curves
from learn2assemble.reproduction.pictures import Line, write_curves


def run(options: argparse.Namespace) -> int:
    output = Output(options.json)
    figure = get_figure(options.name)
    curves = load_curves(figure, options.runs)
    path: Path = options.out / f"{figure.name}.png"
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or "unwritable"
        raise InputError("--out", str(options.out), f"a writable folder ({reason})") from None
    lines = [
        Line(f"{c.label} ({_count(c.seeds)})", c.samples, c.mean, c.low, c.high) for c in curves
    ]
    note = (
        "Training episodes, exploration included; mean over agents, band from the lowest to the "
        "highest, smoothed. " + figure.note
    ).strip()
    write_curves(figure.title, lines, note, path)
    output.table(figure.title, ("line", "agents", "samples", "R", "f", "success"), [
        (c.label, c.seeds, int(c.samples[-1]), *[float(c.mean[q][-1]) for q in
         ("R", "f", "success")]) for c in curves
    ])  # fmt: skip
    absent = sorted({label for label, _ in figure.lines} - {c.label for c in curves})
    if absent:
        output.say(f"no runs of {', '.join(absent)}")
    output.say(str(path))
    output.finish({
        "figure": figure.name, "picture": str(path), "absent": absent,
        "lines": [{"label": c.label, "seeds": c.seeds} for c in curves],
    })  # fmt: skip
    return 0


def _count(seeds: int) -> str:
    return "1 agent" if seeds == 1 else f"{seeds} agents"
