"""What instructions say of blocks, the same on the page, on cards and on paper."""

from __future__ import annotations

import numpy as np

from learn2assemble.assembly.blocks import Action
from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.assembly.instructions.shapes import BlockShape
from learn2assemble.assembly.instructions.steps import (
    BillLine,
    Group,
    Instructions,
    Placement,
)

DOT = " (the dot in pictures)"
"""How cards and PDF show the corner 1 of a block that is told by it."""
HEAD = ("Step", "Shape", "x", "y", "z", "Turn")
"""Of the table of what is placed, see :func:`placement_words`."""
BILL_HEAD = (
    "Shape",
    "Kind",
    "Number",
    "Props",
    "Nominal size [mm]",
    "Block itself [mm]",
    "Mass of one",
)
"""Of the bill, see :func:`bill_words`."""
CUT_HEAD = (
    "Shape",
    "Number",
    "Width × depth [mm]",
    "Longest edge [mm]",
    "Shortest edge [mm]",
    "Top cut at",
)
"""Of the list of posts to cut, see :func:`cut_words`."""
_HOW_TO_READ = (
    "All lengths are in millimetres from O, the front left lower corner of the finished structure: "
    "x to the right, y to the back, z up. x, y and z of a block are its front left lower corner "
    "(of the box round it). Turn: how the block is turned from the way its shape is drawn, about "
    "x, then y, then z, counter-clockwise seen against the axis; 0 is not turned."
)
_CORNER = (
    " Of a block that is turned by other than 90° or 180°, x, y and z are those of its corner 1, "
    "which is the front left lower one before the block is turned"
)
_MOST_CORNERS = 100


def length_words(metres: float, digits: int = 1) -> str:
    """A length in millimetres, without zeros at the end."""
    text = f"{1000 * metres + 0.0:.{digits}f}"
    text = text.rstrip("0").rstrip(".") if digits else text
    return "0" if text in ("-0", "") else text


def extent_words(extents: object) -> str:
    """Lengths in millimetres to a hundredth, e.g. ``99.9 × 49.9 × 50``."""
    return " × ".join(length_words(v, 2) for v in np.asarray(extents, float))


def turn_words(placement: Placement) -> str:
    """Angles about the axes about which it is turned, e.g. ``x 90° z 67.08°``, or ``0``."""
    told = [
        f"{axis} {f'{angle:.2f}'.rstrip('0').rstrip('.')}°"
        for axis, angle in zip("xyz", placement.turn, strict=True)
        if angle
    ]
    return " ".join(told) or "0"


def placement_words(placement: Placement) -> tuple[str, ...]:
    """The line of a block in a table below :data:`HEAD`."""
    x, y, z = (length_words(v) for v in placement.position)
    return (str(placement.number), placement.shape.letter, x, y, z, turn_words(placement))


def place_words(placement: Placement) -> str:
    """How far a block is from O, e.g. ``300 mm to the right of O, 0 mm behind it``."""
    x, y, _ = (length_words(v) for v in placement.position)
    # A verb parts the two numbers, which would read as one.
    return "corner 1 is " * placement.askew + f"{x} mm to the right of O, {y} mm behind it"


def reading_words(told: Instructions, where: str = "") -> str:
    """How the numbers of the steps are read.

    Args:
        told: the instructions; what is said of blocks turned askew stands only where there are any.
        where: how pictures show the corner 1 of a block, if they do.
    """
    return _HOW_TO_READ + f"{_CORNER}{where}." * told.askew


def kind_words(shape: BlockShape) -> str:
    """What a shape is called beside its size: ``block`` where that is all that it is called by."""
    return "block" if shape.kind == millimetres(*shape.size) else shape.kind


def bill_words(line: BillLine) -> tuple[str, ...]:
    """The line of a shape in a table below :data:`BILL_HEAD`."""
    shape = line.shape
    number = f"{line.built}" + f" + {line.standing} standing" * bool(line.standing)
    size, itself = extent_words(shape.nominal), extent_words(shape.size)
    props = str(line.props) if line.props else "–"
    kind = kind_words(shape) + f", {shape.colour}" * shape.asked
    return (shape.letter, kind, number, props, size, itself, f"{shape.mass:.3g} kg")


def cut_words(line: BillLine) -> tuple[str, ...]:
    """The line of a post in a table below :data:`CUT_HEAD`; empty of what is none."""
    cut = line.shape.cut if line.props else None
    if cut is None:
        return ()
    angles = " and ".join(f"{angle:.1f}°" for angle in cut.angles if angle > 0.05) or "0°"
    lengths = (length_words(v, 2) for v in (cut.longest, cut.shortest))
    section = extent_words((cut.width, cut.depth))
    return (line.shape.letter, str(line.props), section, *lengths, angles)


def cut_list(told: Instructions) -> list[tuple[str, ...]]:
    """The posts to cut, in a table below :data:`CUT_HEAD`."""
    return [words for words in map(cut_words, told.bill) if words]


def name_words(id_: str, noun: str = "block") -> str:
    """A block by its id, e.g. ``block v3``, or ``block-10`` as that says what it is."""
    return id_ if id_.lower().startswith(noun) else f"{noun} {id_}"


def _block_words(told: Instructions, placement: Placement) -> str:
    """A block that stands, with the step that placed it, e.g. ``block v3 of
    step 5``; of one that stood from the start, its name."""
    name = name_words(told.assembly.blocks[placement.block].id)
    steps = [
        p.number
        for p in told.placements
        if p.block == placement.block and p.action == "place" and p.number < placement.number
    ]
    return f"{name} of step {steps[-1]}" if steps else name


def done_words(told: Instructions, group: Group) -> str:
    """What is done on a card, in one sentence, e.g. ``Place block v3 and hold
    it; let go of block v2 of step 5.``

    Empty where blocks are placed and hands do nothing else, as tables tell that.
    """
    placed = [p for p in group.placements if p.action == "place"]
    if len(placed) == len(group.placements):
        return ""
    clauses: list[tuple[str, list[str]]] = []
    named: set[int] = set()
    members = list(group.placements)
    while members:
        p = members.pop(0)
        name = name_words(told.assembly.blocks[p.block].id)
        what: str = p.action
        if p.action == "place":
            name = name if len(placed) == 1 else "the blocks"
        elif p.action == "remove":
            name = "the prop" if p.prop else name
        elif clauses and clauses[-1] == ("place", [name]):
            name = "it"
        elif p.block not in named:
            name = _block_words(told, p)
        after = members[:1]
        if told.in_order and [(q.block, q.action) for q in after] == [(p.block, "release")]:
            # The hand that presses a brick home holds it meanwhile.
            members.pop(0)
            what = "press"
        named.add(p.block)
        if clauses and clauses[-1][0] == what:
            clauses[-1][1].extend([name] * (name not in clauses[-1][1]))
        else:
            clauses.append((what, [name]))
    text = ""
    for what, names in clauses:
        listed = " and ".join(names)
        link = " and " if listed == "it" else "; "
        text += f"{link * bool(text)}{_DONE[what].format(listed)}"
    gone = any(p.action == "remove" for p in group.placements)
    return f"{text[0].upper()}{text[1:]}." + " Nothing else may move." * gone


_DONE = {
    "place": "place {}",
    "remove": "take {} away",
    "hold": "hold {}",
    "press": "hold {} level while it is pressed on",
    "release": "let go of {}",
}
"""What is done with blocks."""


def action_words(action: Action, block: str) -> str:
    """What a step with a hand does, e.g. ``Let go of block v3``."""
    if action == "hold":
        return f"Hold {block} (a hand keeps it in its place)"
    return f"Let go of {block}"


_WAYS = {
    "below": "comes from below and is pressed up.",
    "beside": "is built beside, with the blocks of the steps next to it, and brought with them.",
}
"""What is said of a brick that does not come from above."""


def before_words(placement: Placement) -> str:
    """What is said of a step before which mortar has to hold, and of one that a person does while
    an arm waits; empty of any other."""
    words = list[str]()
    if placement.wait is not None:
        words.append(f"Wait {placement.wait:g} h first, until the mortar holds.")
    if placement.by_hand:
        words.append("By hand, while the arm waits.")
    return " ".join(words)


def way_words(placement: Placement, name: str = "it") -> str:
    """What is said of a brick that does not come from above, by a name; empty of any other."""
    return "" if placement.way is None else f"{name[0].upper()}{name[1:]} {_WAYS[placement.way]}"


def corner_words(shape: BlockShape) -> str:
    """The corners of a shape that is no box, from the first; empty of a box."""
    if shape.is_box:
        return ""
    if len(shape.corners) > _MOST_CORNERS:
        return f"{len(shape.corners)}, listed in assembly.json"
    return "; ".join(
        f"{k} ({', '.join(length_words(v, 2) for v in corner)})"
        for k, corner in enumerate(shape.corners, 1)
    )


def facts(told: Instructions) -> tuple[str, ...]:
    """What is said at the head of instructions."""
    placements = told.placements
    blocks = sum(not (b.prop or b.support) for b in told.assembly.finished.blocks)
    found = [
        f"{count_words(blocks, 'block')} in {count_words(len(placements), 'step')} and "
        f"{count_words(told.layers, 'layer')}, told on "
        f"{count_words(len(told.groups), 'card')}",
        f"{extent_words(told.extent)} mm when the last step is done",
    ]
    if told.joint:
        found.append(
            f"vertical joints {length_words(told.joint, 2)} mm wide: the nominal size of a block "
            "is the block itself and one joint"
        )
    if any(p.prop for p in placements):
        found.append("props stand only for a while and are taken away again")
    if any(p.action == "hold" for p in placements):
        found.append("a hand keeps a block that is held in its place until it is let go")
    if by_hand := sum(p.by_hand for p in placements):
        found.append(f"{count_words(by_hand, 'step')} by hand, while the arm waits")
    if waits := [p.wait for p in placements if p.wait is not None]:
        found.append(
            f"{count_words(len(waits), 'wait')} until mortar holds, {sum(waits):g} h in all"
        )
    if left := len(told.assembly.not_built):
        found.append(f"not finished: {count_words(left, 'block')} of the design have no step")
    return tuple(found)


def steps_words(group: Group) -> str:
    """The steps that a card tells, e.g. ``Step 5`` or ``Steps 7 to 12``."""
    first, last = group.steps
    if first == last:
        return f"Step {first}"
    return f"Steps {first} {'and' if last == first + 1 else 'to'} {last}"


def count_words(number: int, noun: str) -> str:
    """``1 block``, ``2 blocks``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
