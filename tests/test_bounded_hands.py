"""Hands of which the wrench is bounded: against cantilevers by hand, turned, and as joints do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from brick_data import bricks
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.assembly.files import from_json, to_json
from learn2assemble.assembly.hands import Hand
from learn2assemble.constants import GRAVITY
from learn2assemble.errors import InputError
from learn2assemble.geometry.circles import ball
from learn2assemble.geometry.rotations import rotation_of
from learn2assemble.planning.clearance import FreeWays
from learn2assemble.planning.crew import alike
from learn2assemble.planning.given import plan_assembly
from learn2assemble.planning.sequence import Supports
from learn2assemble.statics.forces.equilibrium import margin, solve
from learn2assemble.statics.forces.hands import HeldBlock, nearest_wrench
from learn2assemble.statics.holding.program import Push, balance_of
from learn2assemble.statics.states import Pushes, State, States

UP, ASIDE = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])


def only(point: tuple[float, float, float], force: np.ndarray, moment: np.ndarray) -> Hand:
    """A hand that gives nothing but up to this force [N], or up to this moment [N m]."""
    given = np.concatenate([force, moment])
    size = float(np.linalg.norm(given))
    along = given / size
    across = np.linalg.svd(along[None])[2][1:]
    rows = np.vstack([along, -along, across, -across])
    return Hand.within(point, rows, np.array([size, *[0.0] * 11]))


def beam(turn: np.ndarray) -> Assembly:
    """A beam of 1 m that lies on a support of 0.3 m at its end."""
    support = box_block("pier", (0.0, -0.05, 0.0), (0.3, 0.05, 0.2))
    blocks = replace(support, support=True), box_block("beam", (0.0, -0.05, 0.2), (1.0, 0.05, 0.3))
    return Assembly(tuple(_turned(b, turn) for b in blocks), friction=0.6)


def slope(turn: np.ndarray, angle: float) -> Assembly:
    """A block on a wedge of this angle [rad], so steep that it slides."""
    lean = rotation_of(np.array([0.0, -angle, 0.0]))
    support = replace(box_block("wedge", (-0.5, -0.2, -0.1), (0.5, 0.2, 0.0)), support=True)
    block = box_block("stone", (-0.1, -0.1, 0.0), (0.1, 0.1, 0.1))
    return Assembly(tuple(_turned(b, turn @ lean) for b in (support, block)), friction=0.3)


def _turned(block: Block, turn: np.ndarray) -> Block:
    return replace(block, vertices=block.vertices @ turn.T)


def counterweight() -> Assembly:
    """A beam that falls off its pier until a stone stands on its end."""
    stone = box_block("stone", (0.0, -0.05, 0.3), (0.3, 0.05, 0.9))
    return Assembly((*beam(np.eye(3)).blocks, stone), friction=0.6)


def arch(count: int) -> Assembly:
    """A semicircle of voussoirs on the ground."""
    angles = np.linspace(0, np.pi, count + 1)
    joints = np.stack([np.cos(angles), np.zeros_like(angles), np.sin(angles)], 1)
    joints = joints[:, None] * np.array([0.24, 0.36])[:, None]
    deep = np.array([0.0, 0.05, 0.0])
    blocks = []
    for k in range(count):
        corners = joints[k : k + 2].reshape(-1, 3)
        blocks.append(hull_block(f"v{k}", np.concatenate([corners - deep, corners + deep])))
    return Assembly(tuple(blocks), friction=0.6)


def verdicts(assembly: Assembly, hand: Hand) -> set[bool]:
    """Whether the first block stands that is no support: by programs and by elastic joints."""
    everything = np.ones(2, bool)
    held, hands, contacts = np.array([False, True]), {1: hand}, find_contacts(assembly)
    by_program = solve(assembly, contacts, held=held, hands=hands)
    without = solve(assembly, contacts, held=held, hands=hands, coupled=False)
    states = States(assembly, contacts, [assembly.friction])
    state = State(everything, np.zeros(2, bool)).change(hold=[1], hand=hand)
    return {by_program.stands, without.stands, states.stands(state), not states.falls(state)}


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize(("share", "stands"), [(0.99, False), (1.01, True)])
def test_a_cantilever_stands_by_a_force_or_a_moment_just_large_enough(
    yaw: float, share: float, stands: bool
) -> None:
    turn = rotation_of(yaw * UP)
    assembly = beam(turn)
    weight = GRAVITY * assembly.blocks[1].mass
    # It turns about the edge of its support, 0.2 m from its middle and 0.7 m from its end.
    end, edge = turn @ [1.0, 0.0, 0.3], turn @ [0.0, 0.0, 0.2]
    lift = only(tuple(end), share * weight * 0.2 / 0.7 * UP, np.zeros(3))
    assert verdicts(assembly, lift) == {stands}
    # A moment that lifts the far end, about an axis across.
    twist = only(tuple(edge), np.zeros(3), -share * weight * 0.2 * (turn @ ASIDE))
    assert verdicts(assembly, twist) == {stands}


@pytest.mark.parametrize("yaw", [0.0, 2.1])
@pytest.mark.parametrize(("share", "stands"), [(0.99, False), (1.01, True)])
def test_a_stone_on_a_slope_stands_by_a_push_just_large_enough(
    yaw: float, share: float, stands: bool
) -> None:
    angle, turn = math.radians(35.0), rotation_of(yaw * UP)
    assembly = slope(turn, angle)
    weight = GRAVITY * assembly.blocks[1].mass
    needed = weight * (math.sin(angle) - 0.3 * math.cos(angle))
    uphill = turn @ [math.cos(angle), 0.0, math.sin(angle)]
    # In the plane of the bed, so that it does not tilt the stone.
    at = turn @ rotation_of(np.array([0.0, -angle, 0.0])) @ [0.0, 0.0, 0.02]
    hand = only(tuple(at), share * needed * uphill, np.zeros(3))
    assert verdicts(assembly, hand) == {stands}


def test_margins_are_those_of_the_forces_that_are_left() -> None:
    """A beam on the edge of its pier, which a hand lifts at the other end.

    Weight and sideways load are shared by pier and hand alike, 0.714 to 0.286: friction holds
    mu = 0.6 g whatever more the hand could give. A hand that hardly lifts its share of the weight
    has less left: of 0.3 of the weight along edges of its polyhedron, across the beam
    (0.3 sqrt(2) - 0.2857) / 0.2857 = 0.485 g, and no more than that in all directions.
    """
    assembly = beam(np.eye(3))
    weight = GRAVITY * assembly.blocks[1].mass
    contacts, held, share = find_contacts(assembly), np.array([False, True]), ball(3)[1]
    for force, low, high in ((0.3 / share, 0.3, 0.485), (0.6, 0.591, 0.6), (2.0, 0.591, 0.6)):
        hand = Hand.limited((1.0, 0.0, 0.3), force * weight, 1e-3)
        state = State(np.ones(2, bool), np.zeros(2, bool)).change(hold=[1], hand=hand)
        states = States(assembly, contacts, [0.6])
        assert states.stands(state)
        pushes, level = Pushes(states, 10.0), 0.0
        for _ in range(20):
            level = pushes.follow(state)
        found = margin(assembly, contacts, held=held, hands={1: hand})
        assert low <= found <= 1.01 * high
        assert 0.6 * found < level <= 1.01 * found


def test_a_hand_that_lets_go_leaves_nothing_behind() -> None:
    assembly = beam(np.eye(3))
    weight = GRAVITY * assembly.blocks[1].mass
    hand = only((1.0, 0.0, 0.3), 0.5 * weight * UP, np.zeros(3))
    states = States(assembly, find_contacts(assembly), [0.6])
    pushes = Pushes(states, 10.0)
    held = State(np.ones(2, bool), np.zeros(2, bool)).change(hold=[1], hand=hand)
    assert states.stands(held)
    assert pushes.follow(held) > 0
    weaker = held.change(hold=[1], hand=only((1.0, 0.0, 0.3), 0.2 * weight * UP, np.zeros(3)))
    for state in (weaker, held.change(release=[1])):
        assert not states.stands(state)
        assert states.moving(state) == [1]
    assert held.key != weaker.key


def test_a_hand_lifts_a_brick_that_clutches_as_a_push_does() -> None:
    """The best of the forces that a hand may give against each of them as a given load."""
    places = ((0, 0, 0), (2, 0, 1), (4, 0, 2), (6, 0, 3))
    assembly = bricks(*(((4, 2), place) for place in places))
    balance, count = balance_of(assembly), len(assembly.blocks)
    everything, nothing = np.ones(count, bool), np.zeros(count, bool)
    held = nothing.copy()
    held[3] = True
    x, y, z = assembly.blocks[3].centroid
    hand = only((x, y, z), 0.02 * UP, np.zeros(3))
    pushed = [
        balance.need(push=np.array([0.0, 0.0, 0.0, -force])).share
        for force in np.linspace(0.0, 0.02, 21)
    ]
    alone = balance.need(everything, nothing).share
    need = balance.need(everything, held, hands={3: hand}).share
    assert need == pytest.approx(min(pushed), rel=1e-6)
    assert need < 0.99 * alone
    assert balance.need(everything, nothing).share == pytest.approx(alone, rel=1e-9)
    weak = balance_of(assembly.with_capacity(1.2 * 0.7 * alone))
    some = only((x, y, z), 0.01 * UP, np.zeros(3))
    margins = [weak.margin_g(everything, held, {3: one}) for one in (some, hand)]
    assert weak.margin_g(everything, nothing) < margins[0] < margins[1]
    heavy = Push(3, 40.0, (x, y))
    strong = only((x, y, z), 40.0 * UP, np.zeros(3))
    assert not balance.stands(everything, nothing, heavy)
    assert balance.stands(everything, held, heavy, {3: strong})


def test_the_nearest_wrench_is_that_of_a_slow_search() -> None:
    rng = np.random.default_rng(4)
    for _ in range(30):
        rows = rng.normal(size=(12, 6))
        rows /= np.linalg.norm(rows, axis=1)[:, None]
        held = HeldBlock(0, rows, rng.uniform(0.0, 1.0, 12))
        wanted = rng.normal(size=6) * 10.0 ** rng.integers(-1, 7)
        wrench, slope = nearest_wrench(held, wanted)
        size = max(1.0, float(np.abs(wrench).max()))
        coarse = 1e-9 + 1e-14 * float(np.abs(wanted).max())  # of rounding
        assert (rows @ wrench <= held.most + coarse).all()
        # What is left points out of the set: no wrench of it is nearer.
        others = rng.normal(size=(200, 6))
        reach = np.min(
            np.where(others @ rows.T > 0, held.most / np.maximum(others @ rows.T, 1e-9), 1e6), 1
        )
        gain = (others * reach[:, None] - wrench) @ (wanted - wrench)
        assert (gain <= 1e-6 * np.linalg.norm(wanted - wrench) * size * 10).all()
        step = 1e-6 * rng.normal(size=6)
        moved = nearest_wrench(held, wanted + step)[0] - wrench
        assert moved == pytest.approx(slope @ step, abs=1e-8 * max(1.0, np.abs(wanted).max()))


def test_polyhedra_lie_inside_what_they_stand_for() -> None:
    rng = np.random.default_rng(0)
    for dimensions in (2, 3):
        ways, share = ball(dimensions)
        points = rng.normal(size=(2000, dimensions))
        points *= share / (points @ ways.T).max(1)[:, None]
        size = np.linalg.norm(points, axis=1)
        assert size.max() <= 1 + 1e-9
        assert size.min() > 0.85


def test_a_limited_hand_counts_on_a_polyhedron_inside_its_ball() -> None:
    hand, none = Hand.limited((0.0, 0.0, 0.0), 10.0, 1.0), np.zeros(3)
    for way in ((1, 0, 0), (1, 1, 0), (1, 1, 1)):
        unit = np.array(way) / np.linalg.norm(way)
        assert hand.gives(8.86 * unit, none)
        assert hand.gives(none, 0.886 * unit)
        assert not hand.gives(8.87 * unit, none)
    rng = np.random.default_rng(0)
    for unit in rng.normal(size=(2000, 3)):
        unit /= np.linalg.norm(unit)
        assert hand.gives(8.86 * unit, none)
        assert not hand.gives(10.001 * unit, none)
    with pytest.raises(InputError, match="hand: force: got -1, expected 0 or more"):
        Hand.limited((0.0, 0.0, 0.0), -1, 1)
    with pytest.raises(InputError, match=r"hand: moment: got -0\.5, expected 0 or more"):
        Hand.limited((0.0, 0.0, 0.0), 0.0, -0.5)
    for size in (math.nan, math.inf, 1e300):
        with pytest.raises(InputError, match=r"hand: force: got \S+, expected 0 or more, up to"):
            Hand.limited((0.0, 0.0, 0.0), size, 1.0)
    with pytest.raises(InputError, match=r"hand: point: .* expected three finite numbers"):
        Hand.limited((0.0, 0.0), 1.0, 1.0)
    with pytest.raises(InputError, match="three finite numbers"):
        Hand.limited((0.0, 0.0, math.nan), 1, 1)


def test_a_hand_is_written_and_read() -> None:
    hand = Hand.limited((0.1, 0.2, 0.3), 30.0, 1.5, "panda-1")
    steps = AssemblyStep(place="beam"), AssemblyStep(hold="beam", hand=hand)
    again = from_json(to_json(replace(beam(np.eye(3)), steps=steps)))
    assert again.steps[1].hand == hand
    assert hand.gives(np.array([20.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    assert not hand.gives(np.array([31.0, 0.0, 0.0]), np.zeros(3))
    with pytest.raises(InputError, match="0 or more: a hand may give nothing"):
        Hand((0, 0, 0), ((1.0, 0, 0, 0, 0, 0),), (-1.0,))
    with pytest.raises(InputError, match="hand: got 'NaN or infinity'"):
        Hand((0, 0, 0), ((1.0, 0, 0, 0, 0, 0),), (math.nan,))
    good = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for row in (
        (0.0,) * 6,
        (0.0, 0.0, 0.0, 0.0, 1e-300, 0.0),
        (1.0, 0.0),
        (math.nan,) * 6,
        (math.inf,) * 6,
    ):
        with pytest.raises(InputError, match=r"rows\[1\].*6 numbers"):
            Hand((0, 0, 0), (good, row), (1.0, 1.0))  # pyright: ignore[reportArgumentType]
    document = to_json(replace(beam(np.eye(3)), steps=steps))
    document["steps"][1]["hand"]["rows"][3] = [0.0] * 6
    with pytest.raises(InputError, match=r"rows\[3\].*length 1e-09 or more"):
        from_json(document)
    for rows, most in ((np.zeros((1, 6)), np.ones(1)), (np.ones((1, 5)), np.ones(1))):
        with pytest.raises(InputError, match="6 numbers"):
            Hand.within((0, 0, 0), rows, most)
    with pytest.raises(InputError, match="step that holds"):
        AssemblyStep(place="beam", hand=hand)


# ---------------------------------------------------------------- orders


def an_order_exists(assembly: Assembly, hands: Sequence[Hand]) -> bool:
    """By trying everything: one block may be held while the next one comes, its hand may let go or
    stay once that one is held or stands."""
    blocks, contacts = assembly.blocks, find_contacts(assembly)
    count = len(blocks)
    fixed = np.array([block.support for block in blocks])
    ways = FreeWays(blocks, contacts, 1e-4, count)

    def state(there: frozenset[int], *held: int) -> State:
        made = State(np.isin(np.arange(count), [*there]), np.zeros(count, bool))
        for b in held:
            made = made.change(hold=[b], hand=hands[b])
        return made

    def proven(there: frozenset[int], held: int | None, new: int | None) -> bool:
        some = state(there, *([] if held is None else [held]))
        states = States(assembly, contacts, [assembly.friction])
        rests = new is None or states.rests(some, new)
        return rests and states.stands(some)

    begin = frozenset(np.flatnonzero(fixed).tolist())
    seen: set[tuple[frozenset[int], int | None]] = {(begin, None)}
    queue = list(seen)
    while queue:
        there, held = queue.pop()
        some: list[tuple[frozenset[int], int | None, int | None]] = []
        if held is not None:
            some.append((there, None, held))
        for b in set(range(count)) - there:
            if not ways.free(b, state(there).present):
                continue
            after = there | {b}
            some.append((after, held, b))
            taken = States(assembly, contacts, [assembly.friction])
            if taken.stands(state(after, b, *([] if held is None else [held]))):
                some.append((after, b, held))
        for after, keep, new in some:
            if (after, keep) not in seen and proven(after, keep, new):
                seen.add((after, keep))
                queue.append((after, keep))
    return (frozenset(range(count)), None) in seen


@pytest.mark.parametrize("structure", ["arch", "beam"])
def test_an_order_with_hands_of_some_strength_is_found_where_there_is_one(structure: str) -> None:
    """Hands from strong to weak: by all orders and by the search alike, and both verdicts come."""
    assembly = arch(5) if structure == "arch" else counterweight()
    heaviest = max(block.mass for block in assembly.blocks) * GRAVITY
    size = float(np.cbrt(assembly.blocks[-1].volume))
    found: list[bool] = []
    for share in (0.1, 0.5, 1.0, 3.0):

        def hand(block: Block, share: float = share) -> Hand:
            force = share * heaviest
            return Hand.limited(block.centroid.tolist(), force, 0.3 * force * size)

        wanted = an_order_exists(assembly, [hand(block) for block in assembly.blocks])
        plan = plan_assembly(assembly, supports=Supports(holds=1, crew=alike(hand)))
        assert plan.complete == wanted, share
        found.append(wanted)
        if plan.complete:
            assert plan.assembly is not None
            holds = [step for step in plan.assembly.steps if step.action == "hold"]
            assert all(step.hand is not None for step in holds)
            again = plan_assembly(plan.assembly, supports="none")
            assert [s.margin_g for s in again.steps] == [s.margin_g for s in plan.steps]
    assert set(found) == {False, True}
    assert found == sorted(found)
