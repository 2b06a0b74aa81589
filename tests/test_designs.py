"""Designs: what is accepted and refused, round trips, masks, and bounds on the blocks they need."""

from __future__ import annotations

import copy
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bad_designs import BAD, BOX, GOOD, BadDesign
from learn2assemble.errors import InputError
from learn2assemble.geometry.images import HALF_EXTENT, IMAGE_SIZE, ROWS, to_pixels, unproject
from learn2assemble.world.blocks import EDGE, HALF
from learn2assemble.world.design import NUM_LEVELS
from learn2assemble.world.design_bounds import (
    Cell,
    Design,
    Elevation,
    dump_design,
    explain_refusal,
    inside_cells,
    minimum_blocks,
    needed_cells,
    parse_design,
    read_design,
    unsupported_cells,
    write_design,
)
from learn2assemble.world.layouts import side_frames, to_world
from learn2assemble.world.rules import count_row, recover_all
from learn2assemble.world.state import State, empty_state

EXAMPLES = sorted((Path(__file__).parent.parent / "examples" / "designs").glob("*.json"))
PIXEL = HALF_EXTENT / (IMAGE_SIZE / 2)
"""Edge of a pixel in the face plane [m]."""


def box(half: float, height: float, bottom: float = 0.0) -> list[tuple[float, float]]:
    """A rectangle |x| <= half, bottom <= z <= height [m], clockwise as seen."""
    return [(-half, bottom), (-half, height), (half, height), (half, bottom)]


def design(*outlines: Any, **terms: Any) -> Design:
    names = ("a", "b", "c", "d")
    return Design("test", tuple(map(Elevation, names, outlines)), **terms)


# --- random valid designs ---------------------------------------------------------------------


@st.composite
def stars(draw: st.DrawFn, max_x: float = 0.35, max_z: float = 0.6) -> np.ndarray:
    """A simple polygon seen from one inner point, float64[V, 2] [m], either orientation."""
    count = draw(st.integers(4, 12))
    shares = st.lists(st.floats(0, 1), min_size=count, max_size=count)
    t = (np.arange(count) + 0.8 * np.array(draw(shares))) * 2 * np.pi / count
    r = 0.5 + 0.5 * np.array(draw(shares))
    x = max_x * r * np.cos(t)
    z = np.maximum(max_z * (0.5 + 0.5 * r * np.sin(t)) - draw(st.floats(0, 0.2)) * max_z, 0)
    return _accept(np.stack([x, z], -1)[:: draw(st.sampled_from([1, -1]))])


@st.composite
def skylines(draw: st.DrawFn, half: int = 7, levels: int = 12) -> np.ndarray:
    """Towers of whole or broken heights side by side, float64[V, 2] [m]."""
    heights = draw(st.lists(st.floats(0.3, levels), min_size=1, max_size=2 * half - 1))
    left = draw(st.integers(-half, half - len(heights)))
    top = [(left + k + side, h) for k, h in enumerate(heights) for side in (0, 1)]
    points = [(left, 0.0), *top, (left + len(heights), 0.0)]
    kept = [p for k, p in enumerate(points) if p != points[k - 1]]
    return _accept(np.array(kept) * EDGE)


def _accept(outline: np.ndarray) -> np.ndarray:
    """Keep outlines that docs/designs.md allows, decided without the code under test."""
    assume((np.abs(np.diff(outline, axis=0, append=outline[:1])).max(1) > 0).all())
    polygon = shapely.Polygon(outline)
    assume(polygon.is_valid and polygon.area > 0.006)
    # A pixel further than its diagonal from the border is a mask pixel: enough of these.
    assume(polygon.buffer(-PIXEL * 0.75).area > 60 * PIXEL**2)
    return outline


OUTLINES = st.one_of(stars(), skylines())
SMALL = st.one_of(stars(0.075, 0.3), skylines(1, 6))
TEXT = st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "S"]), min_size=1)


@st.composite
def designs(draw: st.DrawFn) -> Design:
    """Any valid design of one or two wide or three or four narrow elevations."""
    outlines = draw(
        st.lists(OUTLINES, min_size=1, max_size=2) | st.lists(SMALL, min_size=3, max_size=4)
    )
    names = draw(st.lists(TEXT, min_size=4, max_size=4, unique=True))
    return Design(
        name=draw(TEXT),
        elevations=tuple(map(Elevation, names, outlines)),
        num_blocks=draw(st.none() | st.integers(2, 400)),
        first_elevation=draw(st.integers(0, len(outlines) - 1)),
        success_threshold=draw(st.floats(0, 1, exclude_min=True, exclude_max=True)),
        supports=draw(st.booleans()),
        description=draw(TEXT | st.just("") | st.just("two\nlines\tand a tab")),
    )


# --- bad input --------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", BAD, ids=lambda bad: bad.name)
def test_bad_design_is_refused_in_one_line(bad: BadDesign, tmp_path: Path) -> None:
    if callable(bad.content):
        path = bad.content(tmp_path)
    else:
        path = tmp_path / "design.json"
        path.write_bytes(bad.content)
    with pytest.raises(InputError) as caught:
        read_design(path)
    message = str(caught.value)
    assert bad.fragment in message
    assert message.isprintable()
    assert path.name.isprintable() is (path.name in message)


def test_bad_designs_differ_from_a_good_one() -> None:
    """Each one is refused for its own reason only while the rest of it is fine."""
    good = parse_design(GOOD, "good")
    assert good == parse_design(json.dumps(GOOD), "good")
    assert len({bad.name for bad in BAD}) == len(BAD) >= 40


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=4,
)
PLACES: list[list[Any]] = [
    *([key] for key in ("format", "version", "name", "description", "units", "elevations")),
    *([key] for key in ("blocks", "first_block", "success_threshold", "supports", "extra")),
    ["first_block", "elevation"],
    *(["elevations", 0, *rest] for rest in ([], ["name"], ["outline"], ["outline", 1])),
    ["elevations", 0, "outline", 2, 0],
]


@given(place=st.sampled_from(PLACES), value=JSON)
@settings(deadline=None, max_examples=100)
def test_any_json_gives_a_design_or_an_input_error(place: list[Any], value: Any) -> None:
    root = copy.deepcopy(GOOD) | {"first_block": {"elevation": 0}}
    inner: Any = root
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    made = _parse_or_refuse(root, "fuzz.json")
    if made is not None:
        assert parse_design(dump_design(made), "again") == made


@given(start=st.integers(0, 200), length=st.integers(0, 20), insert=st.text(max_size=3))
@settings(deadline=None, max_examples=100)
def test_damaged_text_gives_a_design_or_an_input_error(
    start: int, length: int, insert: str
) -> None:
    whole = json.dumps(GOOD)
    _parse_or_refuse(whole[:start] + insert + whole[start + length :], "damaged.json")


def _parse_or_refuse(content: Any, source: str) -> Design | None:
    """The design, or None where it is refused in one line that names the source."""
    try:
        return parse_design(content, source)
    except InputError as error:
        refusal = str(error)
    assert refusal.isprintable()
    assert refusal.startswith(source)
    return None


@pytest.mark.parametrize("outline", [[["a", "b"]], [[1, 2], [3]], 5, None, [[[1]]]])
def test_elevation_made_in_code_is_checked_too(outline: Any) -> None:
    with pytest.raises(InputError):
        Elevation("front", outline)


def test_values_on_the_limits_are_accepted() -> None:
    made = design(box(7 * 0.05, 12 * 0.05), num_blocks=400)
    assert made.elevations[0].area == pytest.approx(0.42)
    design(*[box(0.05 + 0.025, 12 * 0.05)] * 4, num_blocks=2)
    byte_order_mark = "\ufeff" + json.dumps(GOOD)
    with pytest.raises(InputError):
        parse_design(byte_order_mark, "text")


def test_a_file_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "windows.json"
    path.write_text(json.dumps(GOOD), encoding="utf-8-sig")
    assert read_design(path) == parse_design(GOOD, "good")


# --- values and files -------------------------------------------------------------------------


def test_defaults() -> None:
    made = parse_design(GOOD, "good")
    assert (made.num_blocks, made.first_elevation, made.success_threshold) == (None, 0, 0.975)
    assert made.supports
    assert made.description == ""
    four = parse_design(GOOD | {"elevations": [{"outline": BOX}] * 4}, "four")
    assert [side.name for side in four.elevations] == ["front", "back", "right", "left"]


def test_outline_is_clockwise_read_only_and_begins_where_it_was_given() -> None:
    clockwise, other = Elevation("a", np.array(BOX)), Elevation("a", np.array(BOX[::-1]))
    np.testing.assert_array_equal(clockwise.outline, BOX)
    np.testing.assert_array_equal(other.outline, [BOX[3], BOX[0], BOX[1], BOX[2]])
    assert clockwise.area == other.area == pytest.approx(0.01)
    assert not clockwise.outline.flags.writeable
    assert clockwise != other
    assert clockwise != Elevation("b", np.array(BOX))
    assert clockwise == Elevation("a", np.array(BOX))
    assert clockwise.__eq__("a") is NotImplemented


@given(designs())
@settings(deadline=None, max_examples=60)
def test_round_trip_is_exact(made: Design) -> None:
    text = dump_design(made)
    again = parse_design(text, "text")
    assert again == made
    assert hash(again) == hash(made)
    assert dump_design(again) == text
    assert parse_design(json.loads(text), "object") == made


def test_write_never_overwrites(tmp_path: Path) -> None:
    made, path = parse_design(GOOD, "good"), tmp_path / "design.json"
    write_design(made, path)
    assert read_design(path) == made
    path.write_text("mine")
    with pytest.raises(InputError, match="an existing file"):
        write_design(made, path)
    assert path.read_text() == "mine"
    for impossible in (tmp_path / "no" / "x.json", tmp_path / "a\0b", tmp_path):
        with pytest.raises(InputError):
            write_design(made, impossible)


# --- masks ------------------------------------------------------------------------------------


def _pixel_points() -> np.ndarray:
    """(x, z) [m] that each mask pixel stands for: float64[ROWS, IMAGE_SIZE, 2]."""
    return np.array([[unproject(c, r) for c in range(IMAGE_SIZE)] for r in range(ROWS)])


POINTS = shapely.points(_pixel_points())
ABOVE_TABLE_ROW = np.arange(ROWS)[:, None] < 82
"""Row 82 stands for z = 0.5 mm but looks at the table in front of the face plane."""


@given(OUTLINES)
@settings(deadline=None, max_examples=60)
def test_mask_is_the_polygon_at_the_pixel_points(outline: np.ndarray) -> None:
    elevation = Elevation("a", outline)
    mask = to_pixels(elevation.mask())
    polygon = shapely.Polygon(outline)
    clear = shapely.distance(polygon.boundary, POINTS) > 1e-9
    inside = shapely.contains(polygon, POINTS) & ABOVE_TABLE_ROW
    np.testing.assert_array_equal(mask[clear], inside[clear])
    error = abs(mask.sum() * PIXEL**2 - elevation.area)
    assert error <= polygon.length * PIXEL + 4 * PIXEL**2


@given(OUTLINES)
@settings(deadline=None, max_examples=60)
def test_mask_of_the_mirrored_outline_is_mirrored(outline: np.ndarray) -> None:
    mask = to_pixels(Elevation("a", outline).mask())
    mirrored = to_pixels(Elevation("a", outline * [-1, 1]).mask())
    same = mirrored[:, 1:] == mask[:, :0:-1]  # column c is x = 0 at c = 50
    on_edge = shapely.distance(shapely.Polygon(outline * [-1, 1]).boundary, POINTS) <= 1e-9
    assert (same | on_edge[:, 1:]).all()


def test_masks_of_a_design_are_those_of_its_elevations() -> None:
    made = design(box(0.1, 0.2), [(-0.1, 0), (0, 0.2), (0.1, 0)])
    np.testing.assert_array_equal(made.masks()[1], made.elevations[1].mask())
    assert made.masks().shape[:2] == (2, ROWS)


# --- what it takes to build ---------------------------------------------------------------------


def world(made: Design, cells: list[tuple[int, int, int]]) -> State:
    """The simulator's state with the first block and blocks at (elevation, column, level)."""
    frames = side_frames(made.num_sides)
    state = empty_state(1, made.num_sides, 5, len(cells) + 1)
    state.mask[0] = made.masks()
    state.mask_rows[0] = 0, ROWS
    state.mask_pixels[0] = to_pixels(made.masks()).sum()
    for k, (side, column, level) in enumerate([(made.first_elevation, 0, 0), *cells]):
        x, z = np.array(EDGE * column), np.array(HALF + EDGE * level)
        state.position[0, k] = to_world(frames[side], x, np.array(0.0), z)
    state.num_blocks[0] = len(cells) + 1
    state.num_placed[0] = 1
    recover_all(state, 0, frames)
    count_row(state, 0)
    assert state.plane_pixels[0] == state.complete_pixels[0]
    state.initial_pixels[0] = state.plane_pixels[0]
    state.num_placed[0] = len(cells) + 1
    recover_all(state, 0, frames)
    count_row(state, 0)
    return state


def brute_force(made: Design, columns: list[tuple[int, int]], levels: int) -> int:
    """The least blocks over every set of towers, from the simulator's own pixel sets.

    ``columns`` are (elevation, column). A set of blocks covers what its towers cover (3.4).
    """
    start = columns.index((made.first_elevation, 0))
    covered = np.zeros((1, *made.masks().shape), np.uint64)
    blocks = np.zeros(1, int)
    first = world(made, [])
    for k, column in enumerate(columns):
        heights = range(1 if k == start else 0, levels + 1)
        towers = [world(made, [(*column, n) for n in range(h)]).covered[0] for h in heights]
        covered = (covered[:, None] | np.array(towers)).reshape(-1, *covered.shape[1:])
        blocks = (blocks[:, None] + np.array(heights)).ravel()
    pixels = np.bitwise_count(covered & made.masks()).sum((1, 2, 3), dtype=int)
    gained = pixels - first.initial_pixels[0]
    share = gained / (first.mask_pixels[0] - first.initial_pixels[0])
    return int(blocks[share > made.success_threshold].min())


THRESHOLDS = st.sampled_from([0.1, 0.5, 0.75, 0.9, 0.975, 0.999])


@given(st.one_of(stars(0.125, 0.15), skylines(2, 3)), THRESHOLDS)
@settings(deadline=None, max_examples=12)
def test_minimum_of_one_elevation_is_brute_force(outline: np.ndarray, threshold: float) -> None:
    made = design(outline, success_threshold=threshold)
    columns = [(0, k) for k in range(-2, 3)]
    assert minimum_blocks(made) == brute_force(made, columns, 3)


@given(st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=2), THRESHOLDS)
@settings(deadline=None, max_examples=15)
def test_minimum_where_neighbours_share_pixels(ends: list[float], threshold: float) -> None:
    """Columns 2 and 3 both show pixel column 66, which sees x = 0.1247 m."""
    left, right = -0.125 + ends[0], 0.125 + ends[1]
    made = design([(left, 0), (left, 0.05), (right, 0.05), (right, 0)], success_threshold=threshold)
    columns = [(0, k) for k in range(-4, 5)]
    assert minimum_blocks(made) == brute_force(made, columns, 1)


@given(stars(0.075, 0.15), stars(0.075, 0.15), st.integers(0, 1), THRESHOLDS)
@settings(deadline=None, max_examples=8)
def test_minimum_of_two_elevations_is_brute_force(
    front: np.ndarray, back: np.ndarray, first: int, threshold: float
) -> None:
    made = design(front, back, first_elevation=first, success_threshold=threshold)
    columns = [(side, k) for side in range(2) for k in (-1, 0, 1)]
    assert minimum_blocks(made) == brute_force(made, columns, 3)


@pytest.mark.parametrize("first", [0, 2])
def test_minimum_of_four_elevations_is_brute_force(first: int) -> None:
    low, gable = (
        box(0.075, 0.05),
        [(-0.075, 0), (-0.075, 0.04), (0, 0.1), (0.075, 0.04), (0.075, 0)],
    )
    made = design(low, gable, box(0.04, 0.1), low, first_elevation=first, success_threshold=0.9)
    ring = [(0, -1), (0, 0), (0, 1), (1, -1), (1, 0), (1, 1), (2, 0), (3, 0)]
    assert minimum_blocks(made) == brute_force(made, ring, 2)


@pytest.mark.parametrize(
    ("outlines", "least"),
    [
        ([box(0.075, 0.15)], 9),
        ([box(0.075, 0.15), box(0.075, 0.15)], 18),
        ([box(0.075, 0.1)] * 3, 14),
        ([box(0.075, 0.1)] * 4, 16),
        ([box(0.025, 0.2)] * 4, 16),
        ([[(-0.025, 0.1), (-0.025, 0.2), (0.025, 0.2), (0.025, 0.1)]], 4),
    ],
)
def test_minimum_of_boxes(outlines: list[Any], least: int) -> None:
    """A corner of a 3x3 footprint counts once: 8 towers on four sides, 7 on three."""
    assert minimum_blocks(design(*outlines)) == least


@given(designs())
@settings(deadline=None, max_examples=30)
def test_needed_cells_fill_the_design_and_hold_every_pixel_once(made: Design) -> None:
    needed = needed_cells(made)
    cells = [(s, *cell) for s, held in enumerate(needed) for cell in held]
    state = world(made, cells)
    assert state.complete_coverage[0] == 1
    for s, held in enumerate(needed):
        rows, columns = np.nonzero(to_pixels(made.masks()[s])[:81])  # below, the table shows
        x, z = np.array(unproject(columns, rows + 1))
        # Row 49 looks exactly along the edge of levels 4 and 5; the lower one holds it.
        cells_seen = zip(np.rint(x / EDGE), np.ceil(z / EDGE - 1e-9) - 1, strict=True)
        assert held == Counter(Cell(int(k), int(n)) for k, n in cells_seen)


def test_inside_cells_of_a_leaning_outline() -> None:
    (inside,) = inside_cells(design([(-0.1, 0), (0, 0.2), (0.1, 0.2), (0, 0)]))
    assert Cell(-2, 0) in inside
    assert Cell(2, 3) in inside
    assert Cell(2, 0) not in inside
    assert Cell(-2, 3) not in inside


MUSHROOM = [(-0.025, 0), (-0.025, 0.1), (-0.125, 0.1), (-0.125, 0.2), (0.125, 0.2), (0.125, 0.1),
            (0.025, 0.1), (0.025, 0)]  # fmt: skip


def test_an_overhang_needs_supports() -> None:
    (cells,) = unsupported_cells(design(MUSHROOM))
    assert cells == tuple(Cell(k, n) for k in (-2, -1, 1, 2) for n in (2, 3))
    assert explain_refusal(design(MUSHROOM)) is None
    assert minimum_blocks(design(MUSHROOM)) == 20
    strict = design(MUSHROOM, supports=False)
    reason = explain_refusal(strict)
    assert reason is not None
    assert "'a' overhangs at (column -2, level 2)" in reason
    with pytest.raises(InputError, match="overhangs"):
        minimum_blocks(strict)
    assert explain_refusal(design(MUSHROOM, supports=False, success_threshold=0.2)) is None


def test_a_small_overhang_within_the_threshold_is_no_obstacle() -> None:
    nose = [(-0.075, 0), (-0.075, 0.2), (0.085, 0.2), (0.085, 0.19), (0.075, 0.19), (0.075, 0)]
    made = design(nose, supports=False)
    assert unsupported_cells(made)[0] == (Cell(2, 3),)
    assert explain_refusal(made) is None
    assert minimum_blocks(made) == 12


def test_a_tower_of_one_elevation_carries_the_corner_of_another() -> None:
    """Left and right stand at height, on top of the front and the back."""
    low, high = box(0.075, 0.1), [(-0.075, 0.1), (-0.075, 0.2), (0.075, 0.2), (0.075, 0.1)]
    made = design(low, low, high, supports=False)
    assert unsupported_cells(made)[2] == (Cell(0, 2), Cell(0, 3))
    reason = explain_refusal(made)
    assert reason is not None
    assert "'c' overhangs at (column 0, level 2), (column 0, level 3), no cube" in reason


def test_a_floating_outline_needs_supports() -> None:
    floating = [(-0.075, 0.1), (-0.075, 0.2), (0.075, 0.2), (0.075, 0.1)]
    assert explain_refusal(design(floating)) is None
    reason = explain_refusal(design(floating, supports=False))
    assert reason is not None
    assert reason.startswith("the first block stands at the bottom centre of elevation 'a'")


def test_parts_that_stand_apart_need_supports() -> None:
    """Two towers joined by a bar thinner than any cell counts."""
    bar = [(-0.025, 0), (-0.025, 0.15), (0.075, 0.1001), (0.075, 0.15), (0.125, 0.15), (0.125, 0),
           (0.075, 0), (0.075, 0.1), (0.025, 0.1001), (0.025, 0)]  # fmt: skip
    bar[1:2] = [(-0.025, 0.15), (0.025, 0.15), (0.025, 0.1002)]
    assert explain_refusal(design(bar)) is None
    reason = explain_refusal(design(bar, supports=False))
    assert reason is not None
    assert reason.startswith("parts of it stand apart from the first block")


def test_too_few_blocks() -> None:
    outline = box(0.125, 0.15)
    assert explain_refusal(design(outline, num_blocks=15)) is None
    assert (
        explain_refusal(design(outline, num_blocks=14))
        == "needs at least 15 blocks, the design gives 14"
    )


@given(designs())
@settings(deadline=None, max_examples=25)
def test_refusals_are_consistent(made: Design) -> None:
    reason = explain_refusal(made)
    assert reason is None or reason.isprintable()
    free = Design(made.name, made.elevations, supports=True, first_elevation=made.first_elevation,
                  success_threshold=made.success_threshold)  # fmt: skip
    assert explain_refusal(free) is None
    assert 1 <= minimum_blocks(free) <= 1 + 2 * 15 * NUM_LEVELS
    if reason is None:
        least = minimum_blocks(made)
        assert least >= minimum_blocks(free)
        assert made.num_blocks is None or made.num_blocks >= least


# --- examples -----------------------------------------------------------------------------------


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 8
    assert {read_design(path).num_sides for path in EXAMPLES} == {1, 2, 4}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example(path: Path) -> None:
    made = read_design(path)
    assert dump_design(made) == path.read_text(encoding="utf-8")
    assert made.description
    reason = explain_refusal(made)
    if path.stem == "cannot_be_built":
        assert reason is not None
        assert "overhangs" in reason
    else:
        assert reason is None
        assert 6 <= minimum_blocks(made) <= 40


def test_documentation_is_true() -> None:
    """The first example of docs/designs.md parses, and its table of examples is right."""
    text = (EXAMPLES[0].parents[2] / "docs" / "designs.md").read_text(encoding="utf-8")
    small = parse_design(text.split("```json")[1].split("```")[0], "docs")
    assert small.elevations[0].outline[2].tolist() == [0, 0.175]
    for path in EXAMPLES:
        made = read_design(path)
        least = "none" if explain_refusal(made) else minimum_blocks(made)
        assert f"| `{path.name}` | {made.num_sides} | {least} |" in text
