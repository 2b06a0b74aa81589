"""Belief beside truth on the page of a simulated build: how far blocks were from where they were
believed to be and from their places, and where they really were, drawn so that it can be seen."""

from __future__ import annotations

from html import escape
from typing import Any, cast

import numpy as np

from learn2assemble.motion.attempts import block_errors
from learn2assemble.viewer.playback import Playback, split

WIDE, HIGH, LEFT, BELOW = 1000, 150, 46, 16
"""Of a chart and of the room for its axes, in its own units."""
SHOWN, MOST = 0.3, 100
"""The largest error is drawn as long as this share of a block, unless that is more than so many
times as large as it is."""


def error_section(playback: Playback, names: tuple[str, ...]) -> str:
    """Both charts with their heading; empty where nothing is known of the truth.

    Args:
        names: of the blocks of all cells.
    """
    found = block_errors(playback.record)
    if not found:
        return ""
    charts = ""
    for words, of in (("from where it was believed to be", 2), ("from its place", 3)):
        lines = [(names[one.cell], one.first, 1e3 * np.asarray(one[of])) for one in found]
        charts += _chart(f"How far each block really was {words} [mm]", lines)
    worst = 1e3 * max(float(one.belief.max()) for one in found)
    last = 1e3 * max(float(one.place[-1]) for one in found)
    return (
        '<section class="errors" aria-labelledby="errors-title"><h2 id="errors-title">Belief and '
        'truth</h2><p class="lead">After every attempt, as the simulation tells when the build is '
        f"over: no block was ever farther than {worst:.2f} mm from where it was believed to be, "
        f"and at the end none is farther than {last:.2f} mm from its place. A line is a block, the "
        f"thick one the worst.</p>{charts}</section>\n  "
    )


def _chart(words: str, lines: list[tuple[str, int, np.ndarray]]) -> str:
    """Lines over attempts; each with its name, the attempt it begins with, and values."""
    first = min(line[1] for line in lines)
    last = max(line[1] + len(line[2]) - 1 for line in lines)
    top = max(float(values.max()) for _, _, values in lines) or 1.0
    step = 10.0 ** np.floor(np.log10(top / 2))
    step *= next(k for k in (1, 2, 5, 10) if top / (k * step) <= 5)
    most = step * np.ceil(top / step)

    def at(number: float, value: float) -> tuple[float, float]:
        share = (number - first) / max(last - first, 1)
        return LEFT + share * (WIDE - LEFT - 8), 6 + (1 - value / most) * (HIGH - BELOW - 6)

    def path(begin: int, values: np.ndarray) -> str:
        ends = [at(begin + k, float(value)) for k, value in enumerate(values)]
        ends += [ends[0]] * (len(ends) == 1)
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in ends)

    drawn = ""
    ticks = cast("np.ndarray", np.arange(0, most + step / 2, step))
    for tick in ticks.tolist():
        _, y = at(first, tick)
        drawn += f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDE - 8}"/>'
        drawn += f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>'
    for number in sorted({first, (first + last) // 2, last}):
        x, _ = at(number, 0)
        drawn += f'<text x="{x:.1f}" y="{HIGH - 2}" text-anchor="middle">{number}</text>'
    for name, begin, values in lines:
        drawn += f'<path d="{path(begin, values)}"><title>{escape(name)}</title></path>'
    worst = np.zeros(last - first + 1)
    for _, begin, values in lines:
        part = slice(begin - first, begin - first + len(values))
        worst[part] = np.maximum(worst[part], values)
    drawn += f'<path class="worst" d="{path(first, worst)}"/>'
    return (
        f'<figure><figcaption>{words}, over attempts</figcaption><svg viewBox="0 0 {WIDE} {HIGH}" '
        f'role="img" aria-label="{words}: {top:.2f} at most">{drawn}</svg></figure>'
    )


def truth_data(playback: Playback) -> dict[str, Any] | None:
    """Where blocks really were after each attempt, as far from where they were believed to be as
    can be seen, for the scripts; None where nothing is known of it."""
    steps = [step for step in playback.record.steps if step.truth is not None]
    if not steps:
        return None
    truths = [step.truth for step in steps if step.truth is not None]
    there = [
        np.flatnonzero((truth[:, 2] > 0) & (s.after[:, 2] > 0))
        for s, truth in zip(steps, truths, strict=True)
    ]
    off = [
        (truth - s.after)[cells, :3] for s, truth, cells in zip(steps, truths, there, strict=True)
    ]
    largest = max((float(np.linalg.norm(one, axis=1).max()) for one in off if len(one)), default=0)
    size = float(np.median(2 * playback.half.min(1)))
    scale = 1 if largest <= 0 else min(max(1, int(SHOWN * size / largest)), MOST)
    told: dict[str, Any] = {}
    for step, truth, cells, away in zip(steps, truths, there, off, strict=True):
        turned = split(truth)[1]
        told[str(step.number - 1)] = [
            [cell, (step.after[cell, :3] + scale * one).round(5).tolist(), turned[cell].round(5)]
            for cell, one in zip(cells.tolist(), away, strict=True)
        ]
    return {"scale": scale, "after": told}
