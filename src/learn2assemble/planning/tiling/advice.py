"""What would help a design that is not built: every piece of advice is tried before it is given."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from learn2assemble.assembly.instructions.appearance import millimetres
from learn2assemble.assembly.kit import Cell, Kind, Kit, kit_names, load_kit
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.tiling.cover.candidates import BlockPlacement
from learn2assemble.planning.tiling.cover.tile import MAX_EXTENT, Tiling
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.ordering import Ordering
from learn2assemble.planning.tiling.props import choose_props, unsupported

MAX_CELLS = 3000
"""Of a design for which something else is tried; more take minutes."""
NO_ADVICE = (
    "none of what was tried helps: a longer block, other kits, tight joints, filled overhangs, a "
    "flat base, other cells"
)
LONGEST = 12
"""Of a block that the kit has not and that is tried [cells]."""
MOST_CUT = 3
"""Levels that are left out at most for a flat base."""
_SHARE, _MOST = 0.5, 10.0
"""Of the time that is left, for one trial, and no trial takes longer [s]."""


def advise(
    tiling: Tiling,
    kit: Kit,
    seconds: float,
    progress: Callable[[str], None] = lambda text: None,
    **options: Any,
) -> str:
    """What makes a plan of this design complete, in one clause; empty where nothing tried does.

    Tried in this order: more blocks of a heap, for the design or for props; a longer block; joints
    of width 0, the kits of the package, filling what is under an overhang, filling everything down
    to the table, leaving out the lowest levels so that the base is flat, cells half as large, cells
    twice as large.

    Args:
        tiling: that was refused or not found, with the cells that lack support.
        seconds: limit of all trials together.
        options: of :func:`learn2assemble.planning.tiling.exact.plan_exact`.
    """
    clock = Clock(seconds)
    for text, wanted, blocks, changed in _trials(tiling, kit, options):
        if clock.left <= 0 or wanted.sum() > MAX_CELLS or max(wanted.shape) > MAX_EXTENT:
            continue
        progress(f"trying whether {text}")
        made, ordering = plan_exact(
            wanted,
            blocks,
            seconds=min(_MOST, _SHARE * clock.left),
            progress=progress,
            **{**options, **changed},
        )
        if (ordering or made).status == "complete":
            return text
    return ""


def advised_exact(
    wanted: np.ndarray,
    kit: Kit,
    *,
    seconds: float,
    progress: Callable[[str], None] = lambda text: None,
    shades: np.ndarray | None = None,
    **options: Any,
) -> tuple[Tiling, Ordering | None]:
    """The exact plan of a design, and in its reason what would help where there is none.

    Args:
        options, shades: as :func:`.exact.plan_exact` takes them.
    """
    clock = Clock(seconds)
    tiling, ordering = plan_exact(
        wanted, kit, seconds=seconds, shades=shades, progress=progress, **options
    )
    if (ordering or tiling).status in ("refused", "not found") and tiling.placements:
        help_ = advise(tiling, kit, clock.left, progress, **options)
        why = f"{(ordering or tiling).reason}; {help_ or NO_ADVICE}"
        tiling = replace(tiling, reason=why)
        ordering = None if ordering is None else replace(ordering, reason=why)
    return tiling, ordering


_Trial = tuple[str, np.ndarray, Kit, dict[str, Any]]


def _trials(tiling: Tiling, kit: Kit, options: dict[str, Any]) -> Iterator[_Trial]:
    """In words, the cells, the kit and changed options of everything that may help."""
    wanted = tiling.wanted
    width = options.get("gap")
    width = kit.joint_gap if width is None else width
    if lacking := _lacking(tiling, kit, options.get("props_allowed", True)):
        own = _lacking(tiling, kit, False)
        more = ", ".join(f"{n} x {name}" for name, n in sorted(lacking.items()))
        why = "" if own == lacking else ", some for props," if own else ", for props,"
        kinds = tuple(
            replace(kind, count=kind.count + lacking[kind.name])
            if kind.count is not None and kind.name in lacking
            else kind
            for kind in kit.kinds
        )
        yield f"with {more} more{why} it stands", wanted, replace(kit, kinds=kinds), {}
    for length in _bridging(wanted, tiling.lacking):
        cells = tuple((x, 0, 0) for x in range(length))
        if all(kind.cells != cells for kind in kit.kinds):
            longer = replace(kit, kinds=(*kit.kinds, Kind(f"1x{length}, added", cells)))
            yield f"with a block of {length} x 1 x 1 cells in the kit it stands", wanted, longer, {}
    if np.max(width) > 0:
        yield "with tight joints (gap 0) it stands", wanted, kit, {"gap": 0.0}
    for name in kit_names():
        other = load_kit(name)
        if name != kit.name and other.joint.law == "dry":
            yield (
                f"kit `{name}`{_with_cells(kit, other)} does",
                wanted,
                other.at_pitch(kit.pitch),
                {},
            )
    cells = np.array(tiling.lacking, np.int64).reshape(-1, 3)
    for what, under in (
        ("what is under the overhangs", cells),
        ("everything down to the table", np.argwhere(wanted)),
    ):
        filled = fill_below(wanted, under)
        new = np.argwhere(filled & ~wanted)
        if len(new):
            spans = zip("xyz", new.min(0).tolist(), new.max(0).tolist(), strict=True)
            where = ", ".join(
                f"{axis} {a} to {b}" if a < b else f"{axis} {a}" for axis, a, b in spans
            )
            words = f"{len(new)} cells more, within {where}"
            yield f"with {what} filled ({words}) it stands", filled, kit, {}
    for levels in range(1, MOST_CUT + 1):
        higher = wanted[:, :, levels:]
        if higher.any() and wanted[:, :, 0].sum() < 0.5 * higher[:, :, 0].sum():
            yield (
                (
                    f"without its lowest {levels} level{'s' * (levels > 1)}, on a flat base, "
                    "it stands"
                ),
                higher,
                kit,
                {},
            )
    half = replace(kit, pitch=tuple(p / 2 for p in kit.pitch))
    if np.max(width) < min(half.pitch[:2]) / 2:
        finer = wanted.repeat(2, 0).repeat(2, 1).repeat(2, 2)
        yield "with cells half as large it stands", finer, half, {}
    coarser = pool(wanted)
    if coarser[:, :, 0].any() and min(wanted.shape[0], wanted.shape[2]) > 1:
        twice = replace(kit, pitch=tuple(2 * p for p in kit.pitch))
        yield "with cells twice as large it stands", coarser, twice, {}


def _with_cells(kit: Kit, other: Kit) -> str:
    """How another kit is asked for in the cells of a kit; nothing where they are its own."""
    if np.allclose(kit.pitch, other.pitch, rtol=1e-9, atol=0):
        return ""
    return f" with cells of {millimetres(*kit.pitch)}"


def _bridging(wanted: np.ndarray, lacking: Collection[Cell]) -> list[int]:
    """Lengths of blocks that reach over cells which nothing below carries, the shortest first: with
    an end on either side, or a longer half on one, or over all of a row."""
    lengths = set[int]()
    for x, y, z in lacking:
        if z == 0:
            continue
        here, under = wanted[:, :, z], wanted[:, :, z - 1]
        for row, below, at in ((here[:, y], under[:, y], x), (here[x], under[x], y)):
            first, last = _run(row, at)
            low, high = _run(row & ~below, at)
            ends = (low > first) + (high < last)
            open_ = high - low + 1
            if ends:
                lengths |= {open_ + 2 if ends == 2 else 2 * open_ + 1, last - first + 1}
    return sorted(length for length in lengths if 1 < length <= LONGEST)


def _run(row: np.ndarray, at: int) -> tuple[int, int]:
    """First and last index of the True ones of bool[n] that hang together with one of them."""
    low = high = at
    while low > 0 and row[low - 1]:
        low -= 1
    while high + 1 < len(row) and row[high + 1]:
        high += 1
    return low, high


def _lacking(tiling: Tiling, kit: Kit, with_props: bool) -> dict[str, int]:
    """How many blocks of which kinds a heap has too few of for a tiling and, if ``with_props``, for
    its props; empty where it has enough, and where no heap would do."""
    have = {kind.name: kind.count for kind in kit.kinds if kind.count is not None}

    def beyond(blocks: Iterable[BlockPlacement]) -> dict[str, int]:
        used = Counter(block.kind for block in blocks)
        return {name: used[name] - n for name, n in have.items() if used[name] > n}

    structure = replace(tiling, placements=tuple(p for p in tiling.placements if not p.prop))
    own = beyond(structure.placements)
    if not with_props or not kit.limited or (tiling.missing and not own):
        return own
    free = kit.unlimited
    hanging = unsupported(structure, free)
    props = choose_props(structure, free, {b: frozenset((b,)) for b in hanging})
    return beyond((*structure.placements, *(props or ())))


def pool(wanted: np.ndarray) -> np.ndarray:
    """``wanted`` (bool[X, Y, Z]) in cells twice as large, each filled where half of it is; what is
    one cell deep stays so."""
    size = [min(2, n) for n in wanted.shape]
    padded = np.pad(wanted, [(0, -n % k) for n, k in zip(wanted.shape, size, strict=True)])
    blocks = padded.reshape(
        [m for n, k in zip(padded.shape, size, strict=True) for m in (n // k, k)]
    )
    return blocks.mean((1, 3, 5)) >= 0.5


def fill_below(wanted: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """``wanted`` (bool[X, Y, Z]) with all that is under the given cells (int64[n, 3])."""
    filled = wanted.copy()
    for x, y, z in cells.tolist():
        filled[x, y, :z] = True
    return filled
