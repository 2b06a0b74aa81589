"""The column rule against a slow reading of it, and against the equilibrium program."""

# Compiled functions have no stubs that pyright can follow.
# pyright: reportCallIssue=false
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from learn2assemble.constants import EDGE, HALF
from learn2assemble.tasks.physics.equilibrium import is_stable
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
