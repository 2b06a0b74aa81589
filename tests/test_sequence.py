"""The order of given blocks with posts and hands: against definitions, by hand, and as checked."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.contacts import find_contacts
from learn2assemble.assembly.cuts import POST
from learn2assemble.assembly.kit import load_kit
from learn2assemble.assembly.parts import to_manifold
from learn2assemble.cell.structure import ways_in
from learn2assemble.cell.workcell import DOWN
from learn2assemble.errors import InputError
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.clearance import LEVEL, Clearance, FreeWays, overlap, parts_of
from learn2assemble.planning.forward import Forward
from learn2assemble.planning.given import contact_layers, plan_assembly
from learn2assemble.planning.orders import OrderProblem, site_of
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.posts import find_posts
from learn2assemble.planning.sequence import Doing, Transition, depth_first, let_go_of
from learn2assemble.planning.tiling.cover.tile import tile
from learn2assemble.planning.tiling.ordering import to_assembly
from learn2assemble.planning.tiling.stack import find_stack
from learn2assemble.statics.forces.equilibrium import margin, solve
from learn2assemble.statics.laws import ByForces, ByLoads
from learn2assemble.statics.rigid_blocks import FALLS, bed_patches, check
from learn2assemble.statics.states import Pushes, State, States
from learn2assemble.statics.step_proof import Proof

SCRIPTS = Path(__file__).resolve().parents[1] / "examples" / "structures"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def bricks(seed: int, count: int = 8) -> Assembly:
    """Turned bricks in two or three rows, shifted at random: some fall."""
    rng = np.random.default_rng(seed)
    blocks, half = [], np.array([0.12, 0.055, 0.035])
    for k in range(count):
        row, place = divmod(k, 3)
        turn = rng.uniform(-0.4, 0.4)
        x = 0.34 * place + 0.17 * (row % 2) + rng.uniform(-0.03, 0.03)
        at = np.array([x, rng.uniform(-0.06, 0.06), 0.0])
        spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        box = box_block(f"b{k}", -half, half)
        xyz = box.vertices.copy()
        xyz[:, :2] = xyz[:, :2] @ spin.T
        blocks.append(Block(f"b{k}", xyz + at + [0, 0, 0.035 + 0.07 * row], box.faces))
    return Assembly(tuple(blocks), friction=0.6)


def states_of(plan: Plan) -> list[tuple[set[str], set[str]]]:
    """The blocks that are there, and those that are held, in every state that has to stand."""
    assert plan.assembly is not None
    there = {b.id for b in plan.assembly.blocks if b.support}
    held: set[str] = set()
    found = []
    steps = plan.assembly.steps
    for number, step in enumerate(steps):
        if step.action == "place":
            there.add(step.block)
        elif step.action == "remove":
            there.remove(step.block)
        elif step.action == "hold":
            held.add(step.block)
        else:
            held.remove(step.block)
        if steps[number + 1 : number + 2] != (AssemblyStep(hold=step.block),):
            found.append((set(there), set(held)))
    return found


def assert_every_state_stands(plan: Plan) -> None:
    """By the check of what is there, its contacts found anew, held blocks as supports."""
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    ground = box_block("the ground", (-9, -9, -0.1), (9, 9, 0), support=True)
    for there, held in states_of(plan):
        blocks = [
            replace(b, prop=False, support=b.support or b.id in held)
            for b in plan.assembly.blocks
            if b.id in there
        ]
        assembly = Assembly((ground, *blocks), friction=plan.assembly.friction)
        assert check(assembly).verdict != FALLS, (sorted(there), sorted(held))
        contacts = find_contacts(assembly)
        assert solve(assembly, contacts, coupled=False).stands


def most(plan: Plan, more: str, less: str, only: str = "") -> int:
    """The largest number of blocks at once that one action adds and another takes away."""
    assert plan.assembly is not None
    count = best = 0
    for step in plan.assembly.steps:
        if only in ("", plan.assembly.block(step.block).kind):
            count += (step.action == more) - (step.action == less)
            best = max(best, count)
    return best


# ---------------------------------------------------------------- proofs


@pytest.mark.parametrize("seed", range(12))
def test_loads_passed_down_prove_nothing_that_forces_do_not_balance(seed: int) -> None:
    assembly = bricks(seed)
    contacts = find_contacts(assembly)
    contacts = contacts.only(bed_patches(contacts))
    assert ByLoads.fits(contacts)
    rng = np.random.default_rng(seed)
    nothing = np.zeros(len(assembly.blocks), bool)
    agreed = 0
    for _ in range(8):
        state = State(rng.random(len(nothing)) < 0.8, nothing)
        by_loads = ByLoads.of_contacts(assembly, contacts, 0.6, Clock(60)).stands(state)
        if by_loads:
            assert solve(assembly, contacts, 0.6, present=state.present, coupled=False).stands
        agreed += by_loads == States(assembly, contacts, [0.6]).stands(state)
    # Level joints need no friction, but for what is balanced on its edge.
    assert agreed >= 7


def test_states_one_after_another_are_as_each_alone() -> None:
    assembly = script("vaults").barrel_vault(courses=2)
    contacts = find_contacts(assembly)
    kept = States(assembly, contacts, [0.6])
    rng = np.random.default_rng(0)
    verdicts, agreed = set(), 0
    for _ in range(60):
        present = rng.random(18) < 0.95
        state = State(present, present & (rng.random(18) < 0.3))
        stands = kept.stands(state)
        alone = solve(assembly, contacts, 0.6, present=state.present, held=state.held)
        assert alone.stands or not stands
        agreed += stands == alone.stands
        verdicts.add(stands)
    assert agreed >= 58
    assert verdicts == {True, False}


def test_pushes_that_are_followed_are_withstood_and_not_much_less_than_what_is() -> None:
    assembly = script("arch").arch(9)
    contacts = find_contacts(assembly)
    states = States(assembly, contacts, [0.6])
    pushes = Pushes(states, 0.6)
    held = np.zeros(9, bool)
    close = 0
    for count in range(1, 10):
        present = np.arange(9) < count
        held = present & (np.arange(9) == count - 1) & (count < 9)
        found = pushes.follow(State(present, held))
        most = margin(assembly, contacts, 0.6, present=present, held=held)
        assert found <= 1.02 * most + 1e-6
        close += found >= 0.7 * min(most, 0.6)
    assert close >= 7


def test_what_moves_first_is_what_nothing_holds() -> None:
    assembly = script("arch").arch(9)
    states = States(assembly, find_contacts(assembly), [0.6])
    nothing = np.zeros(9, bool)
    assert not states.stands(State(np.arange(9) != 8, nothing))
    moving = states.moving(State(np.arange(9) != 8, nothing))
    assert moving
    assert 0 not in moving
    floating = State(np.isin(np.arange(9), [0, 5]), nothing)
    assert states.moving(floating) == [5]


def test_blocks_of_cells_are_proven_alike_as_cells_and_as_blocks() -> None:
    kit = load_kit("bricks-lintels").at_pitch((0.05, 0.05, 0.05))
    rng = np.random.default_rng(3)
    verdicts = []
    for _ in range(12):
        wanted = rng.random((4, 3, 3)) < 0.75
        wanted[:, :, 0] = True
        tiling = tile(wanted, kit, seconds=20)
        if not tiling.placements:
            continue
        stack = find_stack(tiling.placements, kit, wanted.shape)
        everything = np.ones(len(stack), bool)
        lattice = bool(Proof(stack).program(everything, everything))
        assembly = to_assembly(tiling, None, kit)
        contacts = find_contacts(assembly)
        level = contacts.only(bed_patches(contacts))
        law = ByLoads.of_contacts(assembly, level, 0.5, Clock(60))
        state = State(everything, np.zeros_like(everything))
        assert law.stands(state) == lattice
        verdicts.append(lattice)
    assert len(verdicts) >= 8


def test_a_block_that_is_only_squeezed_in_does_not_rest() -> None:
    """Between two walls friction could hold it, but nothing presses it."""
    assembly = Assembly(
        (
            box_block("left", (0, 0, 0), (1, 1, 3), support=True),
            box_block("right", (2, 0, 0), (3, 1, 3), support=True),
            box_block("bar", (1, 0, 1), (2, 1, 2)),
        ),
        friction=0.9,
    )
    law = ByForces(assembly, find_contacts(assembly), "tight joints", [0.9])
    state = State(np.ones(3, bool), np.zeros(3, bool))
    assert solve(assembly, law.states.contacts, 0.9, coupled=False).stands
    assert not law.rests(state, 2)
    assert not law.stands(state)


# ---------------------------------------------------------------- order


def orders_exist(assembly: Assembly) -> bool:
    """Whether blocks can follow one another so that every state is balanced, by trying all."""
    contacts = find_contacts(assembly)
    count = len(assembly.blocks)
    reached, queue = {0}, [0]
    for state in queue:
        for k in range(count):
            after = state | 1 << k
            if after != state and after not in reached:
                present = np.array([bool(after >> j & 1) for j in range(count)])
                if solve(assembly, contacts, present=present).stands:
                    reached.add(after)
                    queue.append(after)
    return (1 << count) - 1 in reached


@pytest.mark.parametrize("seed", range(8))
def test_an_order_is_found_where_there_is_one(seed: int) -> None:
    assembly = bricks(seed, 6)
    plan = plan_assembly(assembly, supports="none")
    assert plan.complete == orders_exist(assembly)
    if plan.complete:
        assert_every_state_stands(plan)


def test_posts_are_not_looked_for_where_none_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Among many blocks that takes far longer than an order."""

    def found(*args: object) -> None:
        raise AssertionError("posts were looked for")

    monkeypatch.setattr("learn2assemble.planning.orders.find_posts", found)
    assert plan_assembly(script("turned_wall").turned_wall(30)).complete
    assert plan_assembly(script("arch").arch(7), holds=1, supports="none").complete
    with pytest.raises(AssertionError, match="looked for"):
        plan_assembly(script("arch").arch(7))


def test_an_arch_of_nine_stands_on_few_posts_and_they_go_again() -> None:
    plan = plan_assembly(script("arch").arch(9))
    assert_every_state_stands(plan)
    assert plan.assembly is not None
    assert most(plan, "place", "remove", POST) <= 4
    posts = [b for b in plan.assembly.blocks if b.kind == POST]
    assert all(post.prop for post in posts)
    assert {b.kind for b in plan.assembly.finished.blocks} == {""}


@pytest.mark.parametrize("voussoirs", [9, 21])
def test_an_arch_needs_one_hand_that_holds_and_no_post(voussoirs: int) -> None:
    size = {} if voussoirs == 9 else {"radius": 0.5, "thickness": 0.14}
    plan = plan_assembly(script("arch").arch(voussoirs, **size), holds=1)
    assert_every_state_stands(plan)
    assert plan.assembly is not None
    assert len(plan.assembly.blocks) == voussoirs
    # Two hands: one holds while the other brings the next one.
    held = 0
    for step in plan.assembly.steps:
        assert step.action != "place" or held <= 1
        held += (step.action == "hold") - (step.action == "release")
    assert held == 0


def test_posts_come_before_a_search_with_hands_that_leads_nowhere() -> None:
    """The upper blocks of a dome slide until their ring is closed, more of them than hands hold."""
    size = {"rings": 2, "voussoirs": 6, "radius": 0.25, "thickness": 0.08, "top": 70.0}
    dome = replace(script("dome").dome(**size, key=False), friction=0.4)
    plan = plan_assembly(dome, supports="posts", holds=1)
    assert_every_state_stands(plan)
    assert 0 < most(plan, "place", "remove", POST) <= 3


def test_a_voussoir_comes_beside_others_on_a_way_that_leads_away_from_them() -> None:
    """Straight down it would slide along their side faces."""
    dome = script("dome").dome(2, 6, 0.25, 0.08, 50.0, key=False)
    joints, ring = find_contacts(dome), set(range(6))
    for beside in ({7}, {7, 9}):
        came = ways_in(joints, 8, ring | beside)
        touched = [
            normal if b == 8 else -normal
            for a, b, normal in zip(joints.a, joints.b, joints.normal, strict=True)
            if 8 in (a, b) and {int(a), int(b)} - {8} <= ring | beside
        ]
        assert (np.array(touched) @ -np.array(came[0])).min() > 0.04
    # A block on level ground comes straight down, whatever stands beside it.
    pair = [box_block("a", (0, 0, 0), (1, 1, 1)), box_block("b", (1, 0, 0), (2, 1, 1))]
    assert ways_in(find_contacts(Assembly(tuple(pair))), 1, {0})[0] == DOWN


def test_without_help_an_arch_is_not_built_and_it_is_said_what_would_help() -> None:
    plan = plan_assembly(script("arch").arch(7), supports="none")
    assert plan.status == "incomplete"
    assert "with posts it is built" in (plan.reason or "")
    assert plan.steps


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("half", "move first; with posts under v1, v2, v3, v4 to stay it stands"),
        ("smooth", "move first; with a friction of 0.7 it stands"),
        ("hung", "b would move first; with a post under b to stay it stands"),
        ("upright", "falls: wall would move first"),
    ],
)
def test_what_falls_is_named_and_what_would_carry_it(case: str, words: str) -> None:
    arch = script("arch").arch(9)
    foot, high = box_block("a", (0, 0, 0), (1, 1, 1)), (box_block("b", (0.7, 0, 1), (1.7, 1, 2)))
    pillar = box_block("pillar", (0, 0, 0), (1, 1, 1))
    wall = Block("wall", box_block("w", (-9, 0, 1), (1.2, 1, 9)).vertices, foot.faces)
    assembly = {
        "half": replace(arch, blocks=arch.blocks[:5]),
        "smooth": replace(arch, friction=0.1),
        "hung": Assembly((foot, high)),
        # A post under its end is not where it could hold it alone.
        "upright": Assembly((pillar, wall)),
    }[case]
    plan = plan_assembly(assembly)
    assert plan.status == "refused"
    assert words in (plan.reason or "")


def cantilever() -> Assembly:
    """A beam that its tail holds down: before the tail it falls."""
    return Assembly(
        (
            box_block("foot", (0, 0, 0), (1, 1, 1)),
            box_block("beam", (0.4, 0, 1), (2.4, 1, 1.2)),
            box_block("tail", (0.4, 0, 1.2), (1, 1, 3)),
        )
    )


def test_the_fewest_posts_are_found_as_by_trying_all_sets() -> None:
    assembly = cantilever()
    posts = find_posts(assembly.blocks, find_contacts(assembly))
    plan = plan_assembly(assembly)
    assert_every_state_stands(plan)
    assert plan.assembly is not None
    used = len(plan.assembly.blocks) - len(assembly.blocks)
    assert used == 1
    assert not orders_exist(assembly)
    assert len(posts) >= 1


@pytest.mark.parametrize("voussoirs", [7, 21])
@pytest.mark.parametrize("change", ["turn", "mirror", "unit", "order", "far"])
def test_what_is_said_does_not_depend_on_how_it_is_told(change: str, voussoirs: int) -> None:
    """Nor how many posts there are: these go along the ground also where that is turned."""
    assembly = script("arch").arch(voussoirs, radius=0.31, thickness=0.1)
    plain = plan_assembly(assembly)
    blocks = list(assembly.blocks)
    if change == "order":
        blocks = [blocks[2 * k % voussoirs] for k in range(voussoirs)]
    else:
        c, s = np.cos(0.7), np.sin(0.7)
        matrix = {
            "turn": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]),
            "mirror": np.diag([-1.0, 1.0, 1.0]),
            "unit": np.eye(3) * 10,
            "far": np.eye(3),
        }[change]
        far = np.array([1000.0, 2000.0, 0.0]) if change == "far" else np.zeros(3)
        flip = change == "mirror"
        blocks = [
            Block(
                b.id,
                b.vertices @ matrix.T + far,
                tuple(f[::-1] for f in b.faces) if flip else b.faces,
            )
            for b in blocks
        ]
    other = plan_assembly(Assembly(tuple(blocks), friction=assembly.friction))
    assert (other.status, len(other.steps)) == (plain.status, len(plain.steps))


def test_margins_end_when_they_have_taken_as_long_as_the_search_may() -> None:
    """Steps that are proven are kept without them."""
    assembly = script("arch").arch(7)
    seconds = iter(range(10_000))  # Every look at the clock takes one.
    joints = find_contacts(assembly)
    layers = contact_layers(assembly.blocks, joints, lambda: joints, 0.0)

    def told(limit: float) -> list[float | None]:
        clock = Clock(limit, lambda: float(next(seconds)))
        law = site_of(OrderProblem(assembly, layers, (0.7,)), assembly, layers, clock).laws[-1]
        whole = np.ones(len(assembly.blocks), bool)
        assert law.stands(State(whole, ~whole))
        return [law.report(State(whole, ~whole)).margin_g for _ in range(3)]

    assert told(0.3) == [None] * 3
    assert None not in told(1e6)


def test_blocks_may_have_one_place_one_after_the_other() -> None:
    """As of a structure that was turned into another one; not at the same time."""
    base = box_block("base", (0, 0, 0), (0.2, 0.2, 0.2))
    old, new = (box_block(name, (0, 0, 0.2), (0.2, 0.2, 0.3)) for name in ("old", "new"))
    out, back = AssemblyStep(remove="old"), AssemblyStep(place="new")
    whole = Assembly((base, old, new), (out, back))
    assert plan_assembly(whole).status == "complete"
    for steps in ((), (back, out)):
        with pytest.raises(InputError, match=r"'old' and 'new': got '100.0% overlap'"):
            plan_assembly(replace(whole, steps=steps))


def test_what_no_step_places_stands_from_the_start_or_is_not_built() -> None:
    """As the check says, which sees all of it."""
    base = box_block("base", (0, 0, 0), (0.2, 0.2, 0.2))
    upper = box_block("upper", (0, 0, 0.2), (0.2, 0.2, 0.3))
    aside = box_block("aside", (0.5, 0, 0), (0.6, 0.2, 0.2))
    whole = Assembly((base, upper, aside), (AssemblyStep(place="upper"),))
    plan = plan_assembly(whole)
    assert (plan.status, plan.blocks.available, plan.blocks.used) == ("complete", 1, 1)
    assert plan.assembly is not None
    assert len(plan.assembly.finished.blocks) == 3
    assert plan.assembly.at_first == (True, False, True)
    first = (AssemblyStep(place="base"),)
    part = plan_assembly(replace(whole, steps=first, not_built=("upper", "aside")))
    assert (part.status, part.blocks.available, part.blocks.used) == ("incomplete", 3, 1)
    assert part.reason == "no step places upper, aside"
    with pytest.raises(InputError, match="no step that places upper, not proven to stand"):
        plan_assembly(replace(whole, steps=first))


def test_steps_that_are_given_are_proven_with_the_hands_they_name() -> None:
    arch = script("arch").arch(9)
    plan = plan_assembly(arch, holds=1)
    assert plan.assembly is not None
    again = plan_assembly(plan.assembly)
    assert again.complete
    assert [s.action for s in again.steps] == [s.action for s in plan.steps]
    # Without the hands, the first block that needs one falls.
    bare = tuple(s for s in plan.assembly.steps if s.action == "place")
    fallen = plan_assembly(replace(plan.assembly, steps=bare))
    assert not fallen.complete
    assert 0 < len(fallen.steps) < 9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"supports": "props"}, "supports: got 'props'"),
        ({"supports": "wings"}, "supports: got 'wings'"),
        ({"holds": -1}, "holds: got -1"),
        ({"holds": 0.5}, "holds: got 0.5"),
        ({"holds": 100}, "holds: got 100"),
    ],
)
def test_supports_that_are_none_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan_assembly(cantilever(), **arguments)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([AssemblyStep(hold="foot")], "a block in its place"),
        ([AssemblyStep(place="foot"), AssemblyStep(release="foot")], "a block that is held"),
        (
            [AssemblyStep(place="foot"), AssemblyStep(hold="foot"), AssemblyStep(hold="foot")],
            "a block that is not held",
        ),
        (
            [AssemblyStep(place="foot"), AssemblyStep(hold="foot"), AssemblyStep(remove="foot")],
            "not held",
        ),
    ],
)
def test_hands_hold_what_is_there_and_let_go_what_they_hold(
    steps: list[AssemblyStep], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        replace(cantilever(), steps=tuple(steps))


def test_props_of_the_structure_stay_until_all_of_it_stands() -> None:
    """A prop that comes with the blocks carries the beam until its tail holds it down."""
    prop = box_block("prop", (1.8, 0.2, 0), (2.2, 0.8, 1), prop=True)
    assembly = cantilever()
    plan = plan_assembly(replace(assembly, blocks=(prop, *assembly.blocks)), supports="none")
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    told = [(step.action, step.block) for step in plan.assembly.steps]
    assert told[-1] == ("remove", "prop")
    assert told.index(("place", "prop")) < told.index(("place", "beam"))


class _Digits:
    """Numbers of three digits, one digit after the other; only 3, 1, 2 ends well."""

    first = Transition((), State(np.zeros(9, bool), np.zeros(9, bool)))

    def __init__(self, tries: int, patient: bool) -> None:
        self.tries, self.patient, self.looked = tries, patient, 0

    def moves(self, last: Transition) -> Iterator[Transition]:
        present = last.state.present
        row = int(present.sum())
        for digit in range(3) if row < 3 else ():
            if row == 2 and not (present[2] and present[3] and digit == 1):
                continue
            self.looked += 1
            after = last.state.change(place=[3 * row + digit])
            yield Transition((Doing("place", 3 * row + digit),), after)

    def settled(self, move: Transition) -> Transition:
        return move

    def key(self, move: Transition) -> bytes:
        return move.state.key

    def left(self, move: Transition) -> tuple[int, int]:
        return 3 - int(move.state.present.sum()), 0


def test_a_search_that_comes_no_farther_gives_up() -> None:
    rules = _Digits(100, True)
    assert not depth_first(rules, Clock(60), idle=3).complete
    assert rules.looked == 5, "two that came farther, and three that did not"


def test_a_dead_end_is_left_by_the_last_choice_and_work_is_counted() -> None:
    found = depth_first(_Digits(100, True), Clock(60))
    assert found.complete
    assert [step.block for move in found.path for step in move.steps] == [2, 3, 7]
    few = _Digits(4, True)
    found = depth_first(few, Clock(60))
    assert not found.complete
    assert few.looked == 4
    assert len(found.path) == 2


# ---------------------------------------------------------------- room


def test_overlap_is_as_the_solids_say() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        turn = rng.uniform(-1, 1, (2, 3))
        blocks = []
        for k in range(2):
            box = box_block(f"b{k}", (-0.5, -0.3, -0.2), (0.5, 0.3, 0.2))
            q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            q *= np.sign(np.linalg.det(q))
            blocks.append(Block(f"b{k}", box.vertices @ q.T + turn[k] * 0.5, box.faces))
        volume = (to_manifold(blocks[0]) ^ to_manifold(blocks[1])).volume()
        met = overlap(parts_of(blocks[0]), parts_of(blocks[1]), 1e-9)
        assert met == (volume > 1e-9)
        found.append(met)
    assert 10 < sum(found) < 55


def test_a_way_out_may_have_a_turn_but_not_lead_through_walls() -> None:
    """Out of a box with a lid that covers half of it: to the side first, then up."""
    walls = [
        box_block("low", (0, 0, -0.1), (4, 1, 0)),
        box_block("back", (0, 1, 0), (4, 1.1, 2)),
        box_block("front", (0, -0.1, 0), (4, 0, 2)),
        box_block("left", (-0.1, 0, 0), (0, 1, 2)),
        box_block("right", (4, 0, 0), (4.1, 1, 2)),
        box_block("lid", (0, 0, 1.5), (2, 1, 1.6)),
    ]
    inside = box_block("inside", (0.2, 0.1, 0), (1.0, 0.9, 0.8))
    clearance = Clearance((inside, *walls), 1e-4)
    present = np.ones(7, bool)
    assert clearance.leaves(0, present, LEVEL)
    closed = box_block("lid", (0, 0, 1.5), (4, 1, 1.6))
    clearance = Clearance((inside, *walls[:5], closed), 1e-4)
    assert not clearance.leaves(0, present, LEVEL)


def bar(
    name: str, outline: list[tuple[float, float]], near: float, far: float, support: bool = False
) -> Block:
    """An outline of (x, z), counter-clockwise as seen from y < 0, drawn out along y."""
    count = len(outline)
    vertices = [(x, y, z) for y in (near, far) for x, z in outline]
    sides = [((k + 1) % count, k, k + count, (k + 1) % count + count) for k in range(count)]
    ends = [tuple(range(count)), tuple(range(2 * count - 1, count - 1, -1))]
    return Block(name, vertices, [*ends, *sides], support=support)


@pytest.mark.parametrize("thick", [0.004, 0.01, 0.02])
def test_a_thin_part_of_a_block_does_not_pass_through_a_thin_shelf(thick: float) -> None:
    """A block with a fin under a shelf, in a shaft that is as wide as the fin: a way in steps of a
    share of its size would find the fin below the shelf, then above it."""
    low, shelf = 0.05, 0.06 + thick
    high = low + thick
    outline = [
        (0, 0),
        (0.2, 0),
        (0.2, 0.2),
        (0, 0.2),
        (0, high),
        (-0.1, high),
        (-0.1, low),
        (0, low),
    ]
    assembly = Assembly(
        (
            box_block("floor", (-0.4, -0.2, -0.05), (0.5, 0.3, 0), support=True),
            box_block("right", (0.2, -0.1, 0), (0.3, 0.2, 0.6), support=True),
            box_block("front", (-0.3, -0.1, 0), (0.2, 0, 0.6), support=True),
            box_block("back", (-0.3, 0.1, 0), (0.2, 0.2, 0.6), support=True),
            box_block("left", (-0.3, 0, 0), (-0.15, 0.1, 0.6), support=True),
            box_block("shelf", (-0.15, 0, shelf), (-0.01, 0.1, shelf + thick), support=True),
            bar("block", outline, 0, 0.1),
        )
    )
    closed = plan_assembly(assembly)
    assert closed.status == "not found"
    assert closed.reason is not None
    assert closed.reason.startswith("no way to the place of block is free")
    open_ = tuple(block for block in assembly.blocks if block.id != "shelf")
    assert plan_assembly(replace(assembly, blocks=open_)).complete


@pytest.mark.parametrize("slope", [0.0, 30.0])
def test_a_slab_does_not_pass_through_a_thin_cover(slope: float) -> None:
    """The box around a slab on a slope is not thin, but the slab is: it lies in a pit, with a cover
    above it."""
    turn = np.radians(slope)
    turned = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )

    def part(name: str, low: Sequence[float], high: Sequence[float], support: bool = True) -> Block:
        box = box_block(name, low, high)
        return hull_block(name, box.vertices @ turned.T + (0, 0, 1.0), support=support)

    pit = [
        part("base", (-0.1, -0.1, -0.1), (0.4, 0.4, 0)),
        part("low", (0.3, -0.1, 0), (0.4, 0.4, 0.2)),
        part("high", (-0.1, -0.1, 0), (0, 0.4, 0.2)),
        part("front", (0, -0.1, 0), (0.3, 0, 0.2)),
        part("back", (0, 0.3, 0), (0.3, 0.4, 0.2)),
    ]
    slab = part("slab", (0, 0, 0), (0.3, 0.3, 0.01), support=False)
    cover = part("cover", (0, 0, 0.025), (0.3, 0.3, 0.035))
    assert plan_assembly(Assembly((*pit, slab), friction=0.6)).complete
    closed = plan_assembly(Assembly((*pit, cover, slab), friction=0.6))
    assert closed.status == "not found"
    assert closed.reason is not None
    assert closed.reason.startswith("no way to the place of slab is free")


@pytest.mark.parametrize("turned", [0.0, 25.0])
@pytest.mark.parametrize("room", [0.0, 0.01])
def test_a_block_slides_into_a_niche_that_is_open_in_front(turned: float, room: float) -> None:
    """With floor, sides, back and lid as close as that: no way that leads upwards gets out."""
    cos, sin = np.cos(np.radians(turned)), np.sin(np.radians(turned))

    def part(name: str, low: Sequence[float], high: Sequence[float], support: bool = True) -> Block:
        corners = box_block(name, low, high).vertices @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
        return hull_block(name, corners, support=support)

    side, high = 0.1 + room, 0.2 + room
    blocks = (
        part("floor", (-0.4, -0.3, -0.1), (0.4, 0.2, 0)),
        part("left", (-0.3, 0, 0), (-side, 0.2, high)),
        part("right", (side, 0, 0), (0.3, 0.2, high)),
        part("lid", (-0.3, 0, high), (0.3, 0.2, high + 0.1)),
        part("back", (-0.3, 0.2, -0.1), (0.3, 0.3, high + 0.1)),
        part("block", (-0.1, 0, 0), (0.1, 0.2, 0.2), support=False),
    )
    assert plan_assembly(Assembly(blocks), supports="none").complete
    front = part("front", (-0.3, -0.1, 0), (0.3, 0, high + 0.1))
    shut = plan_assembly(Assembly((*blocks, front)), supports="none")
    assert shut.reason is not None
    assert shut.reason.startswith("no way to the place of block is free")


def test_a_block_that_reaches_round_a_bar_slides_on_at_its_end() -> None:
    """Hung on a bar, with lips above it: along the bar alone, unless its ends are walled up."""
    beam = box_block("beam", (0, -0.2, 0.5), (0.1, 0.3, 0.55), support=True)
    outline = [
        (-0.05, 0.4),
        (0.15, 0.4),
        (0.15, 0.6),
        (0.06, 0.6),
        (0.06, 0.55),
        (0.1, 0.55),
        (0.1, 0.5),
        (0, 0.5),
        (0, 0.55),
        (0.04, 0.55),
        (0.04, 0.6),
        (-0.05, 0.6),
    ]
    ring = bar("ring", outline, 0, 0.1)
    assert plan_assembly(Assembly((beam, ring)), supports="none").complete
    ends = [
        box_block(f"end {y:g}", (-0.2, y, 0.4), (0.3, y + 0.1, 0.7), support=True)
        for y in (-0.3, 0.3)
    ]
    shut = plan_assembly(Assembly((beam, *ends, ring)), supports="none")
    assert shut.reason is not None
    assert shut.reason.startswith("no way to the place of ring is free")


def test_a_block_slides_in_only_where_nothing_else_comes() -> None:
    """A brick of the middle course could be drawn out of a wall: it still comes before the next."""
    wall = script("turned_wall").turned_wall(bricks=12)
    contacts = find_contacts(wall)
    ways = FreeWays(wall.blocks, contacts, 1e-4, len(wall.blocks))
    present = np.ones(len(wall.blocks), bool)
    under = int(contacts.a[(contacts.a >= 0) & (np.abs(contacts.normal[:, 2]) > 0.9)][0])
    assert ways.free(under, present)
    assert not ways.free(under, present, sliding=False)
    order = [step.block for step in plan_assembly(wall).steps]
    assert order == sorted(order, key=lambda b: (round(float(wall.blocks[b].centroid[2]), 6), b))


def test_posts_stand_clear_of_all_blocks_and_reach_their_faces() -> None:
    assembly = script("vaults").barrel_vault(courses=1)
    contacts = find_contacts(assembly)
    posts = find_posts(assembly.blocks, contacts)
    assert {post.carries for post in posts} >= set(range(1, 8))
    for post in posts:
        assert post.block.prop
        assert post.block.is_convex
        for block in assembly.blocks:
            assert not overlap(parts_of(post.block), parts_of(block), 1e-4)
        pair = Assembly((assembly.blocks[post.carries], replace(post.block, prop=False)))
        assert len(find_contacts(pair).only(find_contacts(pair).a >= 0).a) == 1


def test_a_prop_that_would_be_closed_in_goes_before() -> None:
    """The key of a dome closes the way out of the posts of the ring below it.

    With a coefficient of 0.6 five of the six blocks of that ring stand on edges alone, whose
    directions are not known well enough.
    """
    dome = replace(script("dome").dome(rings=3, voussoirs=6), friction=0.7)
    plan = plan_assembly(dome, seconds=120)
    assert plan.complete, plan.reason
    assert plan.assembly is not None
    assert not any(b.kind == POST for b in plan.assembly.finished.blocks)


@pytest.mark.parametrize("ground", [0.0, 0.4])
def test_posts_stand_on_the_ground_beside_supports(ground: float) -> None:
    """At the height of the lowest one: a beam that its counterweight holds comes before that."""
    old = box_block("old", (0, 0, ground), (0.2, 0.2, ground + 0.2), support=True)
    beam = box_block("beam", (0.05, 0, ground + 0.2), (0.55, 0.2, ground + 0.3))
    weight = box_block("weight", (0, 0, ground + 0.3), (0.15, 0.2, ground + 0.9))
    assembly = Assembly((old, beam, weight), friction=0.6)
    plan = plan_assembly(assembly)
    assert plan.complete, plan.reason
    assert [step.action for step in plan.steps] == ["place", "place", "place", "remove"]
    assert plan.assembly is not None
    post = plan.assembly.blocks[-1]
    assert post.prop
    assert post.vertices[:, 2].min() == ground
    without = tuple(AssemblyStep(place=name) for name in ("beam", "weight"))
    assert not plan_assembly(replace(assembly, steps=without)).complete
    # Blocks that are no props do not stand there.
    stone = box_block("stone", (1, 0, ground), (1.2, 0.2, ground + 0.2))
    with pytest.raises(InputError, match="no ground"):
        check(Assembly((old, stone)))


def test_posts_for_an_arm_stand_on_its_table_where_supports_reach_below_it() -> None:
    """As beside a pier that ends at the table; without an arm they go down as far as it does."""
    pier, beam, weight = (
        box_block("pier", (0, -0.05, -0.1), (0.1, 0.15, 0.1), support=True),
        box_block("beam", (-0.02, 0, 0.1), (0.3, 0.08, 0.14), density=400),
        box_block("weight", (-0.02, 0, 0.14), (0.08, 0.08, 0.22), density=2800),
    )
    short = box_block("pier", (0, -0.05, 0), (0.1, 0.15, 0.1), support=True)
    made = Assembly((pier, beam, weight))
    plans = [plan_assembly(made), l2a.build(made, arm="panda", physics="kinematic")]
    plans.append(plan_assembly(replace(made, blocks=(short, beam, weight))))
    feet = list[float]()
    margins = list[float | None]()
    for plan in plans:
        assert plan.complete, plan.reason
        assert plan.assembly is not None
        feet.append(float(plan.assembly.blocks[-1].vertices[:, 2].min()))
        margins.append(plan.margin_g)
    assert feet == [-0.1, 0, 0]
    assert margins[1] == pytest.approx(margins[2])


def test_where_posts_do_not_help_and_a_hand_does_it_is_said() -> None:
    """A ridge below the arch leaves posts no floor; advice is tried before it is given."""
    ends = [(x, y, 0.0) for x in (-0.24, 0.24) for y in (-0.2, 0.2)]
    ridge = hull_block("ridge", [*ends, (0, -0.2, 0.2), (0, 0.2, 0.2)])
    arch = script("arch").arch(7)
    arch = replace(arch, blocks=(*arch.blocks, ridge))
    plan = plan_assembly(arch)
    assert not plan.complete
    assert "v1, v5" in (plan.reason or "")
    assert "a hold would help: with one block held at a time it is built" in (plan.reason or "")
    assert plan_assembly(arch, holds=1, supports="none").complete


def test_where_not_even_the_first_block_stands_alone_a_hand_is_tried_too() -> None:
    """Two slabs that lean against each other, cut flat at the ground and upright at the ridge."""
    half = [(-0.1, 0.0), (-0.123, 0.0), (0.0, 0.213), (0.0, 0.173)]
    slabs = [
        hull_block(name, [(side * x, y, z) for x, z in half for y in (0.0, 0.1)])
        for name, side in (("left", 1), ("right", -1))
    ]
    plan = plan_assembly(Assembly(tuple(slabs), friction=0.5))
    assert plan.blocks.used == 0
    assert "a hold would help: with one block held at a time it is built" in (plan.reason or "")


def test_what_is_only_balanced_is_not_said_to_fall() -> None:
    """A prism on its edge: forces balance it, but nothing brings it back."""
    corners = [(x, y, z) for y in (0.0, 0.2) for x, z in ((-0.1, 0.1), (0.1, 0.1), (0.0, 0.0))]
    plan = plan_assembly(Assembly((hull_block("p", np.array(corners)),), friction=0.5))
    assert plan.status == "not found"
    assert "the next step is not proven to stand with any of p" in (plan.reason or "")


def test_a_counterweight_comes_before_what_would_tip_without_it() -> None:
    """Level joints alone: b3 has room on b2, yet tips it over the edge of b1 until b4 is there."""
    heavy = {"density": 10000.0}
    blocks = (
        box_block("b1", (0.0, 0, 0), (0.2, 0.1, 0.05)),
        box_block("b2", (-0.05, 0, 0.05), (0.25, 0.1, 0.1)),
        box_block("b3", (0.14, 0, 0.1), (0.34, 0.1, 0.15), **heavy),
        box_block("b4", (-0.06, 0, 0.1), (0.14, 0.1, 0.15), **heavy),
    )
    # Middles of mass: b2 and b3 at 0.208 m, off b1; b2 and b4 at 0.048 m.
    assert check(Assembly(blocks[:3])).verdict == FALLS
    plan = plan_assembly(Assembly(blocks), supports="none")
    assert plan.status == "complete"
    assert [step.block for step in plan.steps] == [0, 1, 3, 2]


def test_a_prop_behind_another_one_is_walled_in_by_the_structure_alone() -> None:
    """Two props in a tunnel that is closed last: the one behind leaves after the other one."""

    def box(name: str, *ends: float, prop: bool = False) -> Block:
        return box_block(name, ends[:3], ends[3:], prop=prop)

    tunnel = (
        box("left", 0, 0, 0, 1, 4, 2),
        box("right", 2, 0, 0, 3, 4, 2),
        box("back", 1, 3, 0, 2, 4, 2),
        box("roof", 0, 0, 2, 3, 4, 3),
        box("behind", 1, 2, 0, 2, 3, 2, prop=True),
        box("before", 1, 1, 0, 2, 2, 2, prop=True),
    )
    whole = Assembly((*tunnel, box("door", 1, 0, 0, 2, 1, 2)), friction=0.7)
    faces = find_contacts(whole)
    layers = contact_layers(whole.blocks, faces, lambda: faces, 0.0)
    rules = Forward(site_of(OrderProblem(whole, layers, (0.7,)), whole, layers, Clock(60)))
    held, shut = np.zeros(len(whole.blocks), bool), np.ones(len(whole.blocks), bool)
    still_open = shut.copy()
    still_open[whole.index("door")] = False
    assert rules.walled(State(still_open, held)) == []
    assert set(rules.walled(State(shut, held))) == {4, 5}


def test_hands_let_go_one_after_the_other_where_what_stands_between_is_proven() -> None:
    """Of two blocks that both are let go, the one that holds the other one up is the last."""
    both = State(np.ones(3, bool), np.array([False, True, True]))

    def proven(state: State, new: Sequence[int]) -> bool:
        return state.held.tolist() != [False, True, False]

    steps = let_go_of([2, 1], both, proven)
    assert steps is not None
    assert [(step.action, step.block) for step in steps] == [("release", 1), ("release", 2)]
    assert let_go_of([2, 1], both, lambda state, new: not state.held.any()) is None
    assert let_go_of([], both, proven) == []
