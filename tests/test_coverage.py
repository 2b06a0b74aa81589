"""Pixel sets against slow, independent readings of the protocol (3.1 to 3.5)."""

# Compiled functions have no stubs that pyright can follow.
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false, reportIndexIssue=false
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import Phase, assume, example, given, settings
from hypothesis import strategies as st

from learn2assemble.tasks.world.coverage import (
    HALF_EXTENT,
    IMAGE_SIZE,
    NARROW,
    ROWS,
    WIDE,
    WORDS,
    DepthFilter,
    add_box,
    clear_to_ground,
    count_cover,
    paper_mask,
    popcount,
    project,
    span_word,
    to_pixels,
    unproject,
)
from learn2assemble.tasks.world.layouts import sample_outline
from learning_data import from_pixels

HALF = 0.025
SIZE = 100
TAN = math.sqrt(3.0)
SEEDS = st.integers(0, 2**32 - 1)


def real(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, width=64)


def blank() -> np.ndarray:
    return np.zeros((ROWS, WORDS), np.uint64)


# ---------------------------------------------------------------- bits


@given(first=st.integers(-5, 140), last=st.integers(-5, 140), word=st.integers(0, WORDS - 1))
@settings(deadline=None)
def test_span_word_holds_exactly_the_columns_of_the_span(first: int, last: int, word: int) -> None:
    bits = int(span_word(first, last, word))
    columns = {64 * word + k for k in range(64) if bits >> k & 1}
    assert columns == set(range(first, last + 1)) & set(range(64 * word, 64 * word + 64))
    assert popcount(np.uint64(bits)) == len(columns)


@given(SEEDS, st.integers(0, 3))
@settings(deadline=None, max_examples=30)
def test_pixels_to_words_and_back(seed: int, dimensions: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (*rng.integers(1, 4, dimensions), ROWS, IMAGE_SIZE)
    pixels = rng.random(shape) < rng.random()
    words = from_pixels(pixels)
    assert words.shape == (*shape[:-1], WORDS)
    np.testing.assert_array_equal(to_pixels(words), pixels)
    assert np.bitwise_count(words).sum() == pixels.sum()
    np.testing.assert_array_equal(from_pixels(to_pixels(words)), words)


def test_a_column_is_the_bit_that_the_words_promise() -> None:
    pixels = np.zeros((ROWS, IMAGE_SIZE), bool)
    pixels[3, 70] = True
    words = from_pixels(pixels)
    assert words[3, 1] == np.uint64(1 << 6)
    assert np.bitwise_count(words).sum() == 1


# ---------------------------------------------------------------- camera


@given(x=real(-0.6, 0.6), z=real(-0.3, 0.9))
@settings(deadline=None)
def test_project_and_unproject_are_inverse(x: float, z: float) -> None:
    assert unproject(*project(x, z)) == pytest.approx((x, z), abs=1e-12)
    u, v = project(x, z)
    assert project(*unproject(u, v)) == pytest.approx((u, v), abs=1e-9)


def test_projection_has_the_published_numbers() -> None:
    assert project(0.0, 0.25) == (50.0, 50.0)
    assert project(0.0, 0.0)[1] == pytest.approx(82.07, abs=0.01)
    assert abs(HALF_EXTENT - 0.3897) < 1e-4
    edge = project(0.05, 0.0)[0] - project(0.0, 0.0)[0]
    assert edge == pytest.approx(6.415, abs=1e-3)


# ---------------------------------------------------------------- published mask


def brute_mask(outline: np.ndarray) -> np.ndarray:
    """The published mask pixel by pixel: bool[100, 100]."""
    scale = 0.225 * TAN
    corners = []
    for x, z in outline.tolist():
        u, v = 50 * (1 + x / scale), 50 * (1 - (z - 0.25) / scale)
        corners.append([int(math.floor(w) if w > 50 else math.ceil(w)) for w in (u, v)])
    column, row = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    inside = np.ones((SIZE, SIZE), bool)
    for k, (au, av) in enumerate(corners):
        bu, bv = corners[(k + 1) % len(corners)]
        # v points down, so "right of a->b" is a positive cross product.
        right = (bu - au) * (row - av) - (bv - av) * (column - au) > 0
        if len(corners) == 5 and k == 1:
            right |= column >= corners[2][0]
        if len(corners) == 5 and k == 2:
            right |= column < corners[2][0]
        inside &= right
    return inside


def check_mask(outline: np.ndarray) -> None:
    mask = blank()
    mask[:] = np.uint64(2**64 - 1)  # what was there before must not matter
    count = paper_mask(outline, len(outline), mask)
    expected = brute_mask(outline)
    np.testing.assert_array_equal(to_pixels(mask), expected)
    assert count == expected.sum()


POINT = st.tuples(real(-0.45, 0.45), real(-0.05, 0.7))
LATTICE_POINT = st.tuples(
    st.integers(-3, 3).map(lambda k: 0.025 * k), st.integers(0, 4).map(lambda k: 0.05 * k)
)


@given(st.lists(st.one_of(POINT, LATTICE_POINT), min_size=3, max_size=4))
@settings(deadline=None, max_examples=150)
@example([(0.0, 0.0), (0.0, 0.0), (0.0, 0.0)])
@example([(-0.1, 0.0), (0.0, 0.0), (0.1, 0.0)])
@example([(-0.1, 0.0), (-0.1, 0.1), (-0.1, 0.1), (0.1, 0.0)])
@example([(-0.1, 0.0), (0.1, 0.1), (-0.1, 0.1), (0.1, 0.0)])
@example([(0.1, 0.0), (0.0, 0.1), (-0.1, 0.0)])
def test_mask_of_three_and_four_vertices(points: list[tuple[float, float]]) -> None:
    check_mask(np.array(points))


@given(SEEDS, st.integers(1, 6))
@settings(deadline=None, max_examples=100, phases=(Phase.explicit, Phase.generate))
@example(seed=3603392393, grid=1)
def test_mask_of_drawn_outlines(seed: int, grid: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(5):
        outline = np.zeros((5, 2))
        check_mask(outline[: sample_outline(rng, grid, outline)].copy())


@given(
    half=st.tuples(real(0, 0.15), real(0, 0.15), real(0, 0.15), real(0, 0.15)),
    height=st.tuples(real(0, 0.3), real(0, 0.3), real(0, 0.3)),
    middle=real(0, 1),
)
@settings(deadline=None, max_examples=150, phases=(Phase.explicit, Phase.generate))
@example(half=(0.0027, 0.0002, 0.0347, 0.03), height=(0.027, 0.0067, 0.0192), middle=0.901)
@example(half=(0.1, 0.1, 0.1, 0.1), height=(0.1, 0.1, 0.0), middle=0.5)
@example(half=(0.1, 0.1, 0.1, 0.1), height=(0.1, 0.1, 0.2), middle=0.5)
@example(half=(0.0, 0.0, 0.0, 0.0), height=(0.0, 0.0, 0.0), middle=0.0)
def test_mask_of_five_vertices(
    half: tuple[float, ...], height: tuple[float, ...], middle: float
) -> None:
    lb, lt, rt, rb = -half[0], -half[1], half[2], half[3]
    m = lt + middle * (rt - lt)
    points = [(lb, 0.0), (lt, height[0]), (m, height[1]), (rt, height[2]), (rb, 0.0)]
    # M lies between the walls, as the sampler draws it.
    assume(_left_of(points[4], points[3], points[2]) and not _left_of(*points[:3]))
    check_mask(np.array(points))


def _left_of(a: tuple[float, float], b: tuple[float, float], p: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0


RECORDED = [
    # The edge M -> RT falls on the wall or outside it once both are rounded to pixels.
    (
        [
            (-0.0576456, 0.0),
            (-0.073974, 0.1087379),
            (0.040004, 0.0443334),
            (0.0731437, 0.1204558),
            (0.0233596, 0.0),
        ],
        184,
    ),
    (
        [
            (-0.0027075, 0.0),
            (-0.0002333, 0.0269549),
            (0.0312288, 0.0067751),
            (0.0346587, 0.0191579),
            (0.0300365, 0.0),
        ],
        1007,
    ),
]


@pytest.mark.parametrize(("points", "pixels"), RECORDED)
def test_recorded_masks_that_are_open_above(points: list[tuple[float, float]], pixels: int) -> None:
    """Sizes as the published environment reported them."""
    outline = np.array(points)
    assert brute_mask(outline).sum() == pixels
    assert paper_mask(outline, 5, blank()) == pixels


def test_a_roof_vertex_can_dent_or_raise_the_roof() -> None:
    outline = np.array([(-0.1, 0), (-0.1, 0.2), (0.0, 0.2), (0.1, 0.2), (0.1, 0)])
    sizes = []
    for height in (0.1, 0.2, 0.3):
        outline[2, 1] = height
        mask = blank()
        sizes.append(paper_mask(outline, 5, mask))
    assert sizes[0] < 0.8 * sizes[1]
    assert sizes[2] > 1.2 * sizes[1]


# ---------------------------------------------------------------- general mask

U, V = np.meshgrid(np.arange(SIZE), np.arange(SIZE))


# ---------------------------------------------------------------- ray casting


def brute_depth(x: float, y: float, z: float, half: float) -> np.ndarray:
    """Depth [m] at which the ray of every pixel meets a cube, inf where it does not: [100, 100].

    The camera sees nothing before 0.05 m or behind 1 m; what is cut by the first
    plane is seen there. Pixel (r, c) looks through the image point (c, r + 1).
    """
    slope_x = (np.arange(SIZE) - 50.0)[None, :] / 50 * TAN
    slope_z = (50.0 - (np.arange(SIZE) + 1))[:, None] / 50 * TAN
    enter = np.full((SIZE, SIZE), max(y - half + 0.25, 0.05))
    leave = np.full((SIZE, SIZE), min(y + half + 0.25, 1.0))
    for slope, low, high in (
        (slope_x, x - half, x + half),
        (slope_z, z - half - 0.25, z + half - 0.25),
    ):
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = low / slope, high / slope
        near, far = np.minimum(a, b), np.maximum(a, b)
        through = low <= 0 <= high
        near = np.where(slope == 0, -np.inf if through else np.inf, near)
        far = np.where(slope == 0, np.inf if through else -np.inf, far)
        enter, leave = np.maximum(enter, near), np.minimum(leave, far)
    return np.where(enter <= leave, enter, np.inf)


WINDOWS = {NARROW: (0.224, 0.226, 0.0), WIDE: (0.21, 0.25, 1e-6)}
"""Nearest and farthest depth in the plane [m], and how much smaller boxes are seen [m]."""
some_window = st.sampled_from(list(WINDOWS))


def check_box(x: float, y: float, z: float, half: float, depths: DepthFilter) -> None:
    covered, occluded = blank(), blank()
    add_box(covered, occluded, x, y, z, half, depths)
    near, far, margin = WINDOWS[depths]
    # A pixel may go either way only where a change of a nanometre decides.
    small, large = (brute_depth(x, y, z, half - margin + d) for d in (-1e-9, 1e-9))
    for image, limit in ((covered, far), (occluded, near)):
        pixels = to_pixels(image)
        assert not ((small < limit - 1e-9) & ~pixels).any(), "a pixel is missing"
        assert not (pixels & ~(large <= limit + 1e-9)).any(), "a pixel too many"


@given(
    x=real(-0.5, 0.5),
    y=real(-0.4, 0.1),
    z=real(0, 0.7),
    half=st.sampled_from([HALF, 0.06]),
    depths=some_window,
)
@settings(deadline=None, max_examples=150)
@example(x=0.0, y=0.0, z=0.025, half=HALF, depths=NARROW)
@example(x=0.0, y=-0.2, z=0.25, half=HALF, depths=NARROW)  # cut by the near plane, on the axis
@example(x=0.1, y=-0.2, z=0.3, half=HALF, depths=NARROW)  # cut by the near plane, above the camera
@example(x=0.0, y=-0.225, z=0.25, half=HALF, depths=NARROW)  # ends on the near plane
@example(x=0.0, y=-0.23, z=0.25, half=HALF, depths=NARROW)  # wholly before it
@example(x=0.0, y=-0.25, z=0.25, half=0.06, depths=NARROW)  # the camera is inside
@example(x=0.05, y=0.0, z=0.475, half=HALF, depths=NARROW)  # above the camera
@example(x=0.0, y=0.0, z=0.275, half=HALF, depths=NARROW)  # bottom face at the camera's height
@example(x=0.4, y=0.0, z=0.6, half=HALF, depths=NARROW)  # at the corner of the image
def test_box_is_ray_casting(x: float, y: float, z: float, half: float, depths: DepthFilter) -> None:
    check_box(x, y, z, half, depths)


@given(
    st.integers(-7, 7),
    st.integers(-3, 2),
    st.integers(0, 13),
    real(-1e-3, 1e-3),
    st.sampled_from([0.05, 0.055, 0.06]),
    some_window,
)
@settings(deadline=None, max_examples=150)
def test_box_on_the_lattice_is_ray_casting(
    i: int, j: int, k: int, shift: float, pitch: float, depths: DepthFilter
) -> None:
    check_box(pitch * i + shift, pitch * j, 0.05 * k + HALF, HALF, depths)


BOX = st.tuples(real(-0.3, 0.3), real(-0.25, 0.05), real(0.0, 0.6))


@given(st.lists(BOX, max_size=6), st.randoms(use_true_random=False))
@settings(deadline=None, max_examples=50)
def test_pixel_sets_only_grow_whatever_the_order(boxes: list[tuple[float, ...]], random) -> None:
    covered, occluded = blank(), blank()
    clear_to_ground(covered, occluded)
    for box in boxes:
        before = covered.copy(), occluded.copy()
        add_box(covered, occluded, *box, HALF)
        assert not (before[0] & ~covered).any()
        assert not (before[1] & ~occluded).any()
        assert not (occluded & ~covered).any(), "what is nearer than the plane is not behind it"
    shuffled = list(boxes)
    random.shuffle(shuffled)
    again = blank(), blank()
    clear_to_ground(*again)
    for box in shuffled:
        add_box(*again, *box, HALF)
    np.testing.assert_array_equal(again[0], covered)
    np.testing.assert_array_equal(again[1], occluded)


@given(BOX, real(0.001, 0.024))
@settings(deadline=None, max_examples=50)
def test_a_box_within_a_box_fills_no_further_pixel(box: tuple[float, ...], half: float) -> None:
    inner, outer = (blank(), blank()), (blank(), blank())
    add_box(*inner, *box, half)
    add_box(*outer, *box, HALF)
    for small, large in zip(inner, outer, strict=True):
        assert not (small & ~large).any()


def test_the_table_shows_one_row_in_the_plane() -> None:
    """Row 81 looks down 32/50 tan 60 per metre: depth 0.25 / 1.1085 = 0.22553 m, in the window."""
    covered, occluded = blank(), blank()
    clear_to_ground(covered, occluded)
    assert to_pixels(covered).all(1).nonzero()[0].tolist() == list(range(81, 100))
    assert to_pixels(occluded).all(1).nonzero()[0].tolist() == list(range(82, 100))
    assert np.bitwise_count(covered).sum() == 1900


def test_a_tolerant_camera_shows_four_rows_of_the_table() -> None:
    """Row r looks down (r + 1 - 50)/50 tan 60 per metre: rows 78 to 83 see 0.2489 to 0.2123 m.

    The table reaches 0.5 m to the sides of every camera, farther than 0.25 tan 60 = 0.433 m.
    """
    covered, occluded = blank(), blank()
    clear_to_ground(covered, occluded, WIDE)
    assert to_pixels(covered).all(1).nonzero()[0].tolist() == list(range(78, 100))
    assert to_pixels(occluded).all(1).nonzero()[0].tolist() == list(range(84, 100))
    assert np.bitwise_count(covered).sum() == 2200
    # A block in the plane adds its face and two rows of its top, all seven pixels wide but the
    # farther of the two: that row's outer pixels lie exactly on the edge of the block.
    mask = from_pixels(np.ones((ROWS, IMAGE_SIZE), bool))
    before, _ = count_cover(mask, covered, occluded, 0, 78)
    add_box(covered, occluded, 0.0, 0.0, HALF, HALF, WIDE)
    after, _ = count_cover(mask, covered, occluded, 0, 78)
    assert (before, after) == (0, 3 * 7 + 7 + 5)


def test_counts_of_one_block_in_the_plane_by_hand() -> None:
    """Face at 0.225 m: |c - 50| <= 50 * 0.025 / 0.3897 = 3.2, 75.66 <= r + 1 <= 82.08."""
    mask = from_pixels(np.ones((ROWS, IMAGE_SIZE), bool))
    covered, occluded = blank(), blank()
    add_box(covered, occluded, 0.0, 0.0, HALF, HALF)
    rows, columns = to_pixels(covered).nonzero()
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (75, 81, 47, 53)
    assert count_cover(mask, covered, occluded, 0, ROWS) == (49, 49)
    assert count_cover(mask, covered, occluded, 76, 78) == (14, 14)
    # A block behind the face adds nothing, one before it takes the plane filter's pixels away.
    add_box(covered, occluded, 0.0, 0.05, HALF, HALF)
    assert count_cover(mask, covered, occluded, 0, ROWS) == (49, 49)
    # One level up and before the plane, its face (0.175 m) fills |c - 50| <= 4.12 and
    # 74.74 <= r + 1 <= 82.99: 8 rows of 9 pixels. Its top face adds rows 69 to 73, 7 pixels each
    # but in row 73, whose outer two lie on the edge.
    add_box(covered, occluded, 0.0, -0.05, HALF + 0.05, HALF)
    plane, complete = count_cover(mask, covered, occluded, 0, ROWS)
    assert plane == 0
    assert 72 + 5 * 7 <= complete <= 72 + 5 * 7 + 2
