"""The column rule against a slow reading of it, and against the equilibrium program.

The equilibrium program: closed-form cases, a second solver, symmetries and monotonicity.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from learn2assemble.constants import EDGE, HALF
from learn2assemble.errors import InputError
from learn2assemble.tasks.physics.equilibrium import find_contacts, is_stable, stability_margin
from learn2assemble.tasks.physics.protocol import PlacementVerdict
from learn2assemble.tasks.physics.static import StaticPhysics, survey
from learn2assemble.tasks.physics.support import classify_cube
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.blocks import DIRECTIONS
from learn2assemble.tasks.world.rules import move_block, target_cell
from learn2assemble.tasks.world.state import State, empty_state

SEEDS = st.integers(0, 2**32 - 1)
TOLERANCE = 2e-3
CENTRED = 1e-3
SHIFTS = np.array([0.0, 0.0, 0.0, 4e-4, -7e-4, 1.3e-3, -1.7e-3, 2.6e-3, -4.1e-3, 0.011, -0.0237])
"""Displacements from the lattice [m], on both sides of every tolerance."""


def brute(placed: np.ndarray, cube: np.ndarray) -> PlacementVerdict | None:
    """The rule in words: None where a tolerance is met to the nanometre."""
    close = []

    def below(value: float, limit: float) -> bool:
        close.append(abs(value - limit) < 1e-9)
        return value < limit

    bottom = cube[2] - HALF
    buried = below(bottom, -TOLERANCE)
    on_ground = below(bottom, TOLERANCE)
    overlaps, stands, centred = False, False, False
    for other in placed:
        depth = np.minimum(cube, other) + HALF - (np.maximum(cube, other) - HALF)
        deep = [not below(d, TOLERANCE) for d in depth]
        overlaps |= all(deep)
        gap = cube[2] - HALF - (other[2] + HALF)
        if deep[0] and deep[1] and below(abs(gap), TOLERANCE):
            stands = True
            centred |= all(below(abs(cube[k] - other[k]), CENTRED) for k in range(2))
    if any(close):
        return None
    if buried:
        return PlacementVerdict.BELOW_GROUND
    if overlaps:
        return PlacementVerdict.OVERLAP
    if on_ground or centred:
        return PlacementVerdict.STABLE
    return PlacementVerdict.UNDECIDED if stands else PlacementVerdict.FLOATING


def random_cells(rng: np.random.Generator, count: int) -> np.ndarray:
    """Centres near a small lattice [m]; they may overlap, float or be under the table."""
    cells = np.stack(
        [rng.integers(-1, 2, count), rng.integers(0, 2, count), rng.integers(-1, 4, count)], -1
    )
    return EDGE * cells + [0, 0, HALF] + rng.choice(SHIFTS, (count, 3))


@given(seed=SEEDS, count=st.integers(0, 8))
@settings(deadline=None, max_examples=200)
def test_the_compiled_rule_is_the_rule_in_words(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    cells = random_cells(rng, count + 1)
    expected = brute(cells[:count], cells[count])
    assume(expected is not None)
    # Rows beyond the count are stale and must not matter.
    position = np.vstack([cells[:count], np.full((3, 3), HALF)])
    assert classify_cube(position, count, *cells[count].tolist(), HALF) == expected


def test_random_cells_are_of_every_kind() -> None:
    rng = np.random.default_rng(0)
    kinds = set()
    for _ in range(300):
        cells = random_cells(rng, 4)
        kinds.add(brute(cells[:3], cells[3]))
    assert kinds >= {
        PlacementVerdict.STABLE,
        PlacementVerdict.OVERLAP,
        PlacementVerdict.BELOW_GROUND,
        PlacementVerdict.FLOATING,
        PlacementVerdict.UNDECIDED,
    }


@given(
    columns=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=1, max_size=12),
    cell=st.tuples(st.integers(0, 3), st.integers(0, 2), st.integers(0, 4)),
)
@settings(deadline=None, max_examples=60)
def test_column_rule_agrees_with_equilibrium_on_the_lattice(
    columns: list[tuple[int, int]], cell: tuple[int, int, int]
) -> None:
    """Whatever stands in columns: one more cube holds by the rule where the program holds it."""
    cells = [(x, y, columns[:k].count((x, y))) for k, (x, y) in enumerate(columns)]
    assume(cell not in cells)
    centres = EDGE * np.array([*cells, cell], float) + [0, 0, HALF]
    verdict = classify_cube(centres, len(cells), *centres[-1].tolist(), HALF)
    assert verdict in (PlacementVerdict.STABLE, PlacementVerdict.FLOATING)
    assert (verdict == PlacementVerdict.STABLE) == is_stable(centres, np.arange(len(centres)))


# ---------------------------------------------------------------- survey and settle


def leaning_state(rng: np.random.Generator, batch: int, count: int) -> State:
    """Piles with blocks shifted sideways, each resting on another by half its width or more."""
    state = empty_state(batch, 1, 3, count + 2)
    for row in range(batch):
        cells = [np.array([0.0, 0.0, HALF])]
        while len(cells) < count:
            base = cells[rng.integers(len(cells))]
            step = EDGE * DIRECTIONS[rng.integers(5)]
            if step[2] > 0:
                step = step + np.append(rng.choice([0.0, 0.011, -0.0237], 2), 0.0)
            else:
                step = step * [1.2, 1.2, 1.0]
            new = base + step
            found = classify_cube(np.array(cells), len(cells), *new.tolist(), HALF)
            together = np.array([*cells, new])
            if found in (PlacementVerdict.STABLE, PlacementVerdict.UNDECIDED) and is_stable(
                together, np.arange(len(together))
            ):
                cells.append(new)
        state.position[row, :count] = cells
    state.position[:, count:] = 3.0
    state.num_placed[:], state.num_blocks[:] = count, count + 2
    state.num_placed[0] = count - 1  # rows of different length
    return state


def settle_all(state: State) -> np.ndarray:
    """The verdict of a real placement next to every placed block, one by one."""
    physics = StaticPhysics()
    verdict = np.full((*state.position.shape[:2], 5), int(PlacementVerdict.OVERLAP), np.int8)
    for row in range(state.batch_size):
        for reference in range(state.num_placed[row]):
            for relation in range(5):
                trial = state.take(np.array([row]))
                cell = target_cell(trial, 0, reference, relation)
                move_block(trial, 0, 0, reference, *cell)
                before = trial.copy()
                verdict[row, reference, relation] = physics.settle(trial, np.array([0]))[0]
                assert np.array_equal(trial.position, before.position), "blocks never move"
    return verdict


@pytest.mark.parametrize("seed", range(6))
def test_survey_is_the_verdict_of_every_step_also_off_the_lattice(seed: int) -> None:
    state = leaning_state(np.random.default_rng(seed), 2, 6)
    before = state.copy()
    found = survey(state)
    assert np.array_equal(found, settle_all(state))
    assert all(np.array_equal(a, b) for a, b in zip(state, before, strict=True))
    assert not (found == PlacementVerdict.UNDECIDED).any()


def test_leaning_states_need_the_program() -> None:
    verdicts = [survey(leaning_state(np.random.default_rng(seed), 2, 6)) for seed in range(6)]
    assert (np.array(verdicts) == PlacementVerdict.UNSTABLE).any(), (
        "in contact, but not in equilibrium"
    )


@pytest.mark.parametrize("name", ["two-sided-3x3-20-24", "four-sided-3x3-10-18"])
def test_survey_is_the_verdict_of_every_step_on_the_lattice(name: str) -> None:
    sim, rng = Simulator(get_task(name)), np.random.default_rng(2)
    state = sim.new(2, rng)
    for _ in range(6):
        found = survey(state)
        assert np.array_equal(found, settle_all(state))
        chosen = [
            rng.choice(np.argwhere(found[row] == PlacementVerdict.STABLE)) for row in range(2)
        ]
        sim.step(state, np.array([[0, *choice] for choice in chosen]))


def test_settle_judges_only_the_rows_asked_for() -> None:
    state = empty_state(3, 1, 3, 2)
    state.position[:, 0] = 0, 0, HALF
    state.position[:, 1] = [(0, 0, HALF), (0, 0, HALF + EDGE), (0, 0, HALF + 2 * EDGE)]
    state.num_placed[:] = state.num_blocks[:] = 2
    physics = StaticPhysics()
    assert physics.settle(state, np.array([2, 0])).tolist() == [
        PlacementVerdict.FLOATING,
        PlacementVerdict.OVERLAP,
    ]
    assert physics.settle(state, np.array([1])).tolist() == [PlacementVerdict.STABLE]
    assert len(physics.settle(state, np.array([], np.int64))) == 0


PROGRAM_SEEDS = st.integers(0, 2**32 - 1)
ROUND = np.cos(np.pi / 16)
"""Inner radius of a regular polygon of sixteen sides in a circle of radius 1."""


def cubes(*cells: tuple[float, ...]) -> np.ndarray:
    """Centres [m] of cubes given in block edges; the ground level is 0."""
    return EDGE * np.array(cells, float) + [0.0, 0.0, HALF]


def stands(*cells: tuple[float, ...], objects: list[int] | None = None) -> bool:
    ids = np.arange(len(cells)) if objects is None else np.array(objects)
    return is_stable(cubes(*cells), ids)


def random_pile(seed: int, count: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """Off-lattice cubes and bars, each on the ground or on another; every second pile stands."""
    rng = np.random.default_rng(seed)
    reach = rng.choice([0.3, 0.7])
    cells: list[np.ndarray] = [np.zeros((1, 3))]
    ids = [0]
    for number in range(1, count):
        shape = [np.zeros((1, 3)), np.array([[0, 0, 0], [1.0, 0, 0]])][int(rng.random() < 0.4)]
        for _ in range(50):
            base = np.concatenate(cells)
            onto = base[rng.integers(len(base))]
            at = np.array([*(onto[:2] + rng.uniform(-reach, reach, 2)), onto[2] + 1])
            if rng.random() < 0.3:
                at = np.array([*rng.uniform(-2, 2, 2), 0.0])
            new = shape - shape[rng.integers(len(shape))] + at
            if not (np.abs(base[:, None] - new[None]) < 0.999).all(-1).any():
                cells.append(new)
                ids += [number] * len(new)
                break
    return cubes(*np.concatenate(cells)), np.array(ids)


# ---------------------------------------------------------------- contacts


def test_patch_of_two_shifted_cubes() -> None:
    contacts = find_contacts(cubes((0, 0, 0), (0.4, -0.2, 1)), np.arange(2))
    ground = contacts.body_a == -1
    assert ground.sum() == 4
    assert (contacts.body_b[ground] == 0).all()
    patch = contacts.points[~ground] / EDGE
    np.testing.assert_allclose(patch.min(0), [-0.1, -0.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(patch.max(0), [0.5, 0.3, 1.0], atol=1e-12)
    np.testing.assert_array_equal(contacts.normals, np.tile([0, 0, 1], (8, 1)))
    assert set(zip(contacts.body_a[~ground], contacts.body_b[~ground], strict=True)) == {(0, 1)}


def test_side_faces_touch_and_cells_of_one_object_do_not() -> None:
    row = cubes((1, 0, 0), (0, 0, 0), (0, 1, 0))
    apart = find_contacts(row, np.array([5, 9, 7]))
    side = apart.normals[:, 2] == 0
    assert side.sum() == 8
    bodies = {
        (int(np.argmax(n)), int(a), int(b))
        for n, a, b in zip(apart.normals[side], apart.body_a[side], apart.body_b[side], strict=True)
    }
    assert bodies == {(0, 2, 0), (1, 2, 1)}, "x: cube at 0 pushes cube at 1; ids 5, 7, 9 -> 0, 1, 2"
    assert (find_contacts(row, np.array([5, 5, 5])).body_a == -1).all()


@pytest.mark.parametrize(
    ("gap", "touches"), [(0.0, True), (0.0019, True), (-0.0019, True), (0.0021, False)]
)
def test_tolerance_of_a_gap(gap: float, touches: bool) -> None:
    centres = cubes((0, 0, 0), (0, 0, 1 + gap / EDGE))
    assert (len(find_contacts(centres, np.arange(2)).points) == 8) == touches


# ---------------------------------------------------------------- analytic cases


@pytest.mark.parametrize("overhang", [-0.51, -0.49, 0.2, 0.49, 0.5, 0.51, 0.9])
@pytest.mark.parametrize("axis", [0, 1])
def test_overhang_of_one_cube(overhang: float, axis: int) -> None:
    at = [0.0, 0.0, 1.0]
    at[axis] = overhang
    assert stands((0, 0, 0), tuple(at)) == (abs(overhang) <= 0.5)


def test_overhang_held_by_a_weight_on_its_inner_end() -> None:
    base, beam = (0, 0, 0), (0.6, 0, 1)
    assert not stands(base, beam)
    assert stands(base, beam, (0.35, 0, 2)), "both together at 0.475"
    assert not stands(base, beam, (0.45, 0, 2)), "both together at 0.525"


@pytest.mark.parametrize(("scale", "stable"), [(0.99, True), (1.01, False)])
def test_harmonic_overhang(scale: float, stable: bool) -> None:
    count = 6
    steps = scale * 0.5 / np.arange(count - 1, 0, -1)
    x = np.concatenate([[0.0], np.cumsum(steps)])
    assert stands(*[(x[k], 0, k) for k in range(count)]) == stable


@pytest.mark.parametrize(
    ("support", "stable"),
    [
        ([(0, 0, 0)], False),
        ([(1, 0, 0)], True),
        ([(0, 0, 0), (1, 0, 0)], True),
        ([(0, 0, 0), (2, 0, 0)], True),
        ([(2, 0, 0)], False),
    ],
)
def test_a_bar_of_three_needs_its_middle_supported(
    support: list[tuple[int, int, int]], stable: bool
) -> None:
    bar = [(0, 0, 1), (1, 0, 1), (2, 0, 1)]
    ids = [*range(len(support)), *[9] * 3]
    assert stands(*support, *bar, objects=ids) == stable


def test_bar_held_by_a_counterweight() -> None:
    bar = [(0, 0, 1), (1, 0, 1), (2, 0, 1)]
    assert not stands((0, 0, 0), *bar, objects=[0, 1, 1, 1])
    weights = [(0, 0, 2), (0, 0, 3), (0, 0, 4)]
    assert stands((0, 0, 0), *bar, *weights, objects=[0, 1, 1, 1, 2, 3, 4]), "CoM at 0.5"
    assert not stands((0, 0, 0), *bar, *weights[:2], objects=[0, 1, 1, 1, 2, 3]), "CoM at 0.6"


def test_s_and_l_on_one_cell() -> None:
    s = [(1, 0, 0), (0, 0, 0), (0, 0, 1), (-1, 0, 1)]
    assert stands(*s, objects=[0] * 4)
    up = [(x, y, z + 1) for x, y, z in s]
    assert stands((0, 0, 0), *up, objects=[0, 1, 1, 1, 1])
    assert not stands((1, 0, 0), *up, objects=[0, 1, 1, 1, 1])
    corner = [(1, 0, 1), (0, 0, 1), (0, 1, 1)]
    assert stands((0, 0, 0), *corner, objects=[0, 1, 1, 1]), "CoM at (1/3, 1/3)"
    assert not stands((1, 0, 0), *corner, objects=[0, 1, 1, 1])


def test_cells_of_one_object_hold_each_other_but_blocks_do_not() -> None:
    bridge = [(0, 0, 0), (2, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)]
    assert stands(*bridge, objects=[0, 1, 2, 2, 2])
    assert not stands(*bridge)


def test_floating_and_empty() -> None:
    assert not stands((0, 0, 0), (0, 0, 2))
    assert not stands((0, 0, 1))
    nothing, ids = np.zeros((0, 3)), np.zeros(0, int)
    assert is_stable(nothing, ids)
    assert stability_margin(nothing, ids, 0.7) == 0.7


@pytest.mark.parametrize("height", [1, 2, 3, 5, 12])
@pytest.mark.parametrize("friction", [1.0, 0.25])
def test_margin_of_a_column(height: int, friction: float) -> None:
    centres = cubes(*[(0, 0, k) for k in range(height)])
    margin = stability_margin(centres, np.arange(height), friction)
    # The round cone of friction is cut by a polygon of sixteen sides, a tipping column is not.
    assert min(1 / height, ROUND * friction) - 1e-9 <= margin <= min(1 / height, friction) + 1e-9
    if 1 / height < ROUND * friction:
        assert margin == pytest.approx(1 / height)


def test_margin_of_an_overhang_and_of_what_does_not_stand() -> None:
    for overhang in (0.1, 0.3, 0.49):
        centres = cubes((0, 0, 0), (overhang, 0, 1))
        # About the edge of the lower cube: (0.5 - s) w against a w / 2.
        both = (0.5 - overhang / 2) / 1.0
        expected = min(2 * (0.5 - overhang), both)
        assert stability_margin(centres, np.arange(2)) == pytest.approx(expected)
    assert stability_margin(cubes((0, 0, 0), (0.6, 0, 1)), np.arange(2)) == 0.0
    assert stability_margin(cubes((0, 0, 1)), np.arange(1)) == 0.0


# ---------------------------------------------------------------- second solver


def reference_margins(
    centres: np.ndarray, ids: np.ndarray, friction: float, angles: np.ndarray
) -> list[float] | None:
    """The same question put differently: forces as (n, tx, ty), torques about the world's origin.

    Contacts by a double loop over cubes; the octagon by its eight facets, turned so that it is
    exact along each direction. None where infeasible.
    """
    patches = []
    for j, upper in enumerate(centres):
        if abs(upper[2] - HALF) < 2e-3:
            patches.append((None, ids[j], upper[:2] - HALF, upper[:2] + HALF, 0.0))
        for i, lower in enumerate(centres):
            low = np.maximum(lower[:2], upper[:2]) - HALF
            high = np.minimum(lower[:2], upper[:2]) + HALF
            above = abs(upper[2] - lower[2] - EDGE) < 2e-3
            if ids[i] != ids[j] and above and (high - low > 2e-3).all():
                patches.append((ids[i], ids[j], low, high, (upper[2] + lower[2]) / 2))
    names = sorted(set(ids.tolist()))
    forces = [
        (a, b, np.array([x, y, z]))
        for a, b, low, high, z in patches
        for x in (low[0], high[0])
        for y in (low[1], high[1])
    ]
    width = 3 * len(forces) + 1
    equal, load = np.zeros((6 * len(names), width)), np.zeros(6 * len(names))
    for k, (a, b, point) in enumerate(forces):
        wrench = np.zeros((6, 3))
        for column, axis in enumerate(np.eye(3)[[2, 0, 1]]):
            wrench[:3, column], wrench[3:, column] = axis, np.cross(point, axis)
        for name, sign in ((a, -1), (b, 1)):
            if name is not None:
                row = 6 * names.index(name)
                equal[row : row + 6, 3 * k : 3 * k + 3] += sign * wrench
    bounds = [(0, None), (None, None), (None, None)] * len(forces) + [(0, None)]
    margins = []
    for way in angles:
        direction = [np.cos(way), np.sin(way), 0]
        side = way + np.pi / 8 * (2 * np.arange(8) + 1)
        cut = np.stack([np.full(8, -friction * np.cos(np.pi / 8)), np.cos(side), np.sin(side)], 1)
        facets = np.pad(np.kron(np.eye(len(forces)), cut), ((0, 0), (0, 1)))
        for name in names:
            row = 6 * names.index(name)
            for centre in centres[ids == name]:
                push = np.array(direction, float)
                pull = np.array([0.0, 0.0, 1.0])
                load[row : row + 6] += np.concatenate([pull, np.cross(centre, pull)])
                equal[row : row + 6, -1] += np.concatenate([push, np.cross(centre, push)])
        result = linprog(
            -np.eye(width)[-1], facets, np.zeros(len(facets)), equal, load, bounds, method="highs"
        )
        load[:], equal[:, -1] = 0.0, 0.0
        if result.status == 2:
            return None
        assert result.status == 0, result.message
        margins.append(float(-result.fun))
    return margins


def test_random_piles_are_of_both_kinds() -> None:
    outcomes = [is_stable(*random_pile(seed, 4)) for seed in range(60)]
    assert 15 < sum(outcomes) < 45


@settings(max_examples=25, deadline=None)
@given(seed=PROGRAM_SEEDS, count=st.integers(1, 5), friction=st.sampled_from([0.2, 0.5, 1.0]))
def test_agrees_with_a_second_formulation(seed: int, count: int, friction: float) -> None:
    centres, ids = random_pile(seed, count)
    angles = np.arange(16) * np.pi / 8
    expected = reference_margins(centres, ids, friction, angles)
    assert is_stable(centres, ids, friction) == (expected is not None)
    margin = stability_margin(centres, ids, friction)
    if expected is None:
        assert margin == 0.0
        return
    # In all directions, not those of the axes alone; a round set loses two percent.
    assert ROUND * min(expected) - 1e-6 <= margin <= min(expected) + 1e-6
    between = reference_margins(centres, ids, friction, angles[:4] + 0.13)
    assert between is not None
    assert margin <= min(between) + 1e-6


# ---------------------------------------------------------------- symmetry, monotonicity


@settings(max_examples=25, deadline=None)
@given(seed=PROGRAM_SEEDS, shift=st.tuples(*[st.floats(-3, 3)] * 2), kind=st.integers(0, 3))
def test_mirrors_turns_and_shifts_change_nothing(
    seed: int, shift: tuple[float, float], kind: int
) -> None:
    centres, ids = random_pile(seed, 5)
    x, y, z = centres.T
    image = [(x, y, z), (-x, y, z), (y, x, z), (-y, x, z)][kind]
    moved = np.stack(image, -1)
    moved[:, :2] += shift
    order = np.random.default_rng(seed).permutation(len(ids))
    moved, renamed = moved[order], (1000 - 7 * ids)[order]
    assert is_stable(moved, renamed) == is_stable(centres, ids)
    margin = stability_margin(centres, ids)
    assert stability_margin(moved, renamed) == pytest.approx(margin, abs=1e-6)


@settings(max_examples=25, deadline=None)
@given(seed=PROGRAM_SEEDS)
def test_more_friction_or_glue_never_harm(seed: int) -> None:
    centres, ids = random_pile(seed, 5)
    slippery, rough = (is_stable(centres, ids, friction) for friction in (0.1, 1.0))
    assert slippery <= rough
    glued = np.where(ids == ids.max(), ids[np.argmin(np.abs(ids - ids.max() + 1))], ids)
    assert rough <= is_stable(centres, glued)
    margin = stability_margin(centres, ids)
    assert 0.0 <= stability_margin(centres, ids, 0.1) <= margin + 1e-9
    assert margin <= 1.0
    assert rough or margin == 0.0
    far = np.vstack([centres, cubes((50, 0, 0))])
    assert is_stable(far, np.append(ids, 99)) == rough


@settings(max_examples=20, deadline=None)
@given(cells=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2)), min_size=1, max_size=15))
def test_lattice_columns_always_stand(cells: list[tuple[int, int]]) -> None:
    """The column rule of physics.static never contradicts the program."""
    placed = [(x, y, cells[:k].count((x, y))) for k, (x, y) in enumerate(cells)]
    assert stands(*placed)
    tallest = max(z for _, _, z in placed) + 1
    margin = stability_margin(cubes(*placed), np.arange(len(placed)))
    assert margin == pytest.approx(1 / tallest if tallest > 1 else ROUND)


# ---------------------------------------------------------------- errors


def test_errors_name_the_argument() -> None:
    one = cubes((0, 0, 0))
    with pytest.raises(InputError, match="centres"):
        is_stable(np.zeros(3), np.zeros(1, int))
    with pytest.raises(InputError, match="centres"):
        find_contacts(one * np.nan, np.zeros(1, int))
    with pytest.raises(InputError, match="object_id"):
        is_stable(one, np.zeros(2, int))
    with pytest.raises(InputError, match="friction"):
        stability_margin(one, np.zeros(1, int), -0.1)
