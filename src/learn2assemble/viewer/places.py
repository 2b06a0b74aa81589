"""Where an arm takes blocks from, as a table of the page."""

from __future__ import annotations

import math
from html import escape

import numpy as np

from learn2assemble.assembly.instructions.words import extent_words, length_words
from learn2assemble.motion.places import Lying, PickPlace, Stands, supplied
from learn2assemble.viewer.html import NUMBER, row
from learn2assemble.viewer.playback import Playback

_HEAD = (
    "Place",
    "Kind",
    "Blocks",
    "Size as it lies [mm]",
    "Mass",
    "x",
    "y",
    "z",
    "Turn",
    "Steps",
    "Refill",
)
_NUMBERS = (2, 4, 5, 6, 7, 8)


def place_section(playback: Playback, origin: np.ndarray, planed: str = "") -> str:
    """The table of places with its heading; nothing where no block is taken from a place.

    Args:
        playback: of all arms.
        origin: float64[3]: the point O of the instructions in the world [m].
        planed: what has to be done to some props before, in words.
    """
    several, found = len(playback.arms) > 1, supplied(playback.record)
    rows, refills = list[str](), sum(place.refills for place in found.places)
    for place in found.places:
        who = {
            playback.arms[step.arm].name
            for step, pick in zip(playback.steps, found.picks, strict=True)
            if pick is not None and pick.place == place.number
        }
        cells = [", ".join(sorted(who))] * several + _cells(place)
        rows.append(row(list(map(escape, cells)), {k + several: NUMBER for k in _NUMBERS}))
    if not rows:
        return ""
    for one in found.stands:
        cells = [""] * several + _standing_cells(one)
        rows.append(row(list(map(escape, cells)), {k + several: NUMBER for k in _NUMBERS}))
    head = "<th>Arm</th>" * several + "".join(
        f"<th {NUMBER}>{word}</th>" if k in _NUMBERS else f"<th>{word}</th>"
        for k, word in enumerate(_HEAD)
    )
    x, y, z = (length_words(v) for v in -origin)
    lead = (
        "x, y and z are the middle of a block as it lies [mm], in the world frame of the plan: "
        f"from the middle of the design on the table, which is at x {x}, y {y}, z {z} from O. "
        "Turn: of its long side, from x about z."
    )
    lead += (
        " A place that is refilled holds one block at a time: whoever refills it, a feeder or a "
        "person, lays the next one there before the step that takes it."
    ) * bool(refills)
    lead += f" {escape(planed)}." * bool(planed)
    return (
        '<section class="attempts places" aria-labelledby="places-title"><h2 id="places-title">'
        f'Where blocks are taken from</h2><p class="lead">{lead}</p>'
        '<div class="scroll"><table><thead>'
        f"<tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div></section>\n  "
    )


def _cells(place: PickPlace) -> list[str]:
    mass = f"{1000 * place.mass:.0f} g"
    head = str(place.number), place.what, str(len(place.blocks)), extent_words(place.size), mass
    return [*head, *_where(place), place.step_words, place.refill_words]


def _standing_cells(one: Stands) -> list[str]:
    mass = f"{1000 * one.mass:.0f} g" * bool(one.name)
    words = "set by hand" if one.by_hand else "stands there from the start"
    return ["", one.what, "1", extent_words(one.size), mass, *_where(one), "", words]


def _where(one: Lying) -> list[str]:
    shown = np.round(1000 * one.centre, 1) + 0.0
    turn = round(math.degrees(one.turn), 1) + 0.0
    return [*(f"{value:g}" for value in shown), f"{turn:g}°"]
