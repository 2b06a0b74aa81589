"""From one structure to another: the order, its proofs and the bound of its moves."""

from __future__ import annotations

import heapq
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from learn2assemble.acting.carry_out import carry_out, prepare
from learn2assemble.acting.state import Action, Choice
from learn2assemble.assembly.blocks import Assembly, AssemblyStep, hull_block
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.files import read_assembly
from learn2assemble.assembly.instructions.steps import instructions
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cell.site import Magazine, Pallet, Pose, Site
from learn2assemble.cell.site_arms import SiteArm
from learn2assemble.cell.workcell import StepOf, Workcell
from learn2assemble.cell.world import LOOSE, STANDING
from learn2assemble.cli import main
from learn2assemble.cli.commands import _print_plan
from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError
from learn2assemble.export.cards import step_cards
from learn2assemble.export.robot_programs import export_program, replay_program
from learn2assemble.jobs.build import build
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.rebuilding.rebuild import changed_over, rebuild, with_copies
from learn2assemble.plants.setup import Disturbance
from learn2assemble.statics.rigid_blocks import check
from learn2assemble.statics.states import State
from learn2assemble.team.crew import Member
from learn2assemble.team.members import set_up_team
from learn2assemble.team.pair import jobs_of
from learn2assemble.viewer.page import write_plan_page


def wall(wide: int, high: int, at: int = 0) -> np.ndarray:
    """bool[X, Y, Z]: a wall of so many cells, from a place of a site 14 wide."""
    cells = np.zeros((14, 1, 8), bool)
    cells[at : at + wide, 0, :high] = True
    return cells


def planned(cells: np.ndarray) -> Plan:
    plan = build(cells, kit="bricks")
    assert plan.complete
    return plan


def bricks(*rows: tuple[tuple[int, int], ...]) -> Plan:
    """The plan of a wall from rows of bricks (from, to) in cells of 0.1 m, from below."""
    blocks = [
        box_block(f"{a}-{b}/{z}", (a / 10, 0, z / 10), (b / 10, 0.1, (z + 1) / 10), kind=f"{b - a}")
        for z, row in enumerate(rows)
        for a, b in row
    ]
    return build(Assembly(tuple(blocks)))


def standing(plan: Plan) -> Assembly:
    assert plan.assembly is not None
    return plan.assembly


def random_bricks(rng: np.random.Generator) -> Plan | None:
    """A small wall of random bricks that stands and has an order."""
    rows, left, right = [], int(rng.integers(0, 3)), int(rng.integers(4, 7))
    for _ in range(int(rng.integers(1, 4))):
        row, at = [], left
        while at < right:
            end = min(at + int(rng.integers(1, 4)), right)
            row.append((at, end))
            at = end
        rows.append(tuple(brick for brick in row if rng.random() < 0.8) or (row[0],))
    try:
        plan = bricks(*rows)
    except InputError:
        return None
    return plan if plan.complete else None


def check_states(plan: Plan) -> None:
    """Every state stands by the check of any structure, and no two blocks overlap in it."""
    whole = standing(plan)
    there = {b.id for b, here in zip(whole.blocks, whole.at_first, strict=True) if here}
    for step in (None, *whole.steps):
        if step is not None:
            there ^= {step.block}
        if there:
            blocks = tuple(block for block in whole.blocks if block.id in there)
            assert check(replace(whole, blocks=blocks, steps=())).verdict != "falls"


def fewest(old: Assembly, plan: Plan) -> int | None:
    """The fewest moves of all orders, looked for in all of them (Dijkstra)."""
    assert plan.assembly is not None
    change, rules, _ = changed_over(
        old.finished, plan, 60.0, plan.gap_range[1] if plan.gap_range else 0.0
    )
    count = len(change.blocks)
    start, end = (sum(1 << k for k in np.flatnonzero(s)) for s in (change.old, change.new))
    queue, known = [(0, start, -1)], {(start, -1): 0}
    stands: dict[tuple[int, int], bool] = {}

    def array(mask: int) -> np.ndarray:
        return np.array([bool(mask >> k & 1) for k in range(count)])

    def may(there: int, block: int) -> bool:
        """Whether a block may come to the others of a state, or leave them."""
        key = there, block
        if key not in stands:
            present = array(there)
            some = change.overlaps[block] | change.above[block]
            free = not any(present[k] for k in some)
            stands[key] = free and rules.site.ways.free(block, present)
        return stands[key]

    while queue:
        moves, there, hand = heapq.heappop(queue)
        if there == end:
            return moves
        if known[there, hand] < moves:
            continue
        for block in range(count):
            leaves = bool(there >> block & 1)
            after, kind = there ^ 1 << block, int(change.kind[block])
            if not may(after if leaves else there, block):
                continue
            if rules.law(State(array(after), np.zeros(count, bool))) is None:
                continue
            cost = moves + (leaves or hand != kind)
            key = after, kind if leaves else -1
            if cost < known.get(key, 10**9):
                known[key] = cost
                heapq.heappush(queue, (cost, *key))
    return None


def test_a_block_that_is_free_goes_straight_to_its_new_place():
    tower, pair = bricks(((0, 1),), ((0, 1),)), bricks(((0, 1), (2, 3)))
    plan = rebuild(standing(tower), pair)
    assert plan.rebuilt is not None
    assert (plan.rebuilt.moves, plan.rebuilt.moves_bound) == (1, 1)
    assert (plan.rebuilt.kept, plan.rebuilt.taken, plan.rebuilt.placed) == (1, 1, 1)
    assert [step.action for step in plan.steps] == ["remove", "place"]


def test_what_is_missing_comes_from_the_supply_and_what_is_left_over_goes():
    one, three = bricks(((0, 1),)), bricks(((0, 1), (2, 3), (4, 5)))
    more, fewer = rebuild(standing(one), three), rebuild(standing(three), one)
    assert more.rebuilt is not None
    assert fewer.rebuilt is not None
    assert (more.rebuilt.moves, more.rebuilt.supplied) == (2, 2)
    assert (fewer.rebuilt.moves, fewer.rebuilt.placed) == (2, 0)
    assert standing(fewer).finished.blocks[0].id == "0-1/0"


@pytest.mark.parametrize("asked", [0.2, (0.2, 0.7)])
def test_margins_are_for_the_least_friction_that_was_asked_for(asked: float | tuple[float, float]):
    old, new = standing(bricks(((0, 1), (2, 3)))), standing(bricks(((0, 1),), ((0, 1),)))
    plan = build(new, friction=asked, old=old)
    assert plan.complete
    assert plan.margin_friction == 0.2
    assert all(0 < (step.margin_g or 0) <= 0.2 for step in plan.steps)
    usual = build(new, old=old)
    assert usual.margin_friction == new.friction
    assert all((step.margin_g or 0) > 0.2 for step in usual.steps)
    # Cells stand without any.
    cells = build(wall(2, 1), kit="bricks", friction=asked, old=standing(planned(wall(4, 1))))
    assert cells.margin_friction == 0.2
    assert all(0 < (step.margin_g or 0) <= 0.2 for step in cells.steps if step.margin_g)


def test_the_same_structure_needs_no_move():
    plan = planned(wall(7, 3))
    same = rebuild(standing(plan), plan)
    assert same.rebuilt is not None
    assert (same.status, same.steps, same.rebuilt.moves_bound) == ("complete", (), 0)


def test_what_lies_on_a_block_that_goes_leaves_first_and_comes_back():
    old, new = bricks(((0, 2),), ((0, 1),)), bricks(((0, 1),), ((0, 1),))
    plan = rebuild(standing(old), new)
    assert plan.complete
    assert plan.rebuilt is not None
    # The upper one stays, but what is below is another one: it leaves, the base goes, and it comes.
    ids = [(step.action, step.block) for step in standing(plan).steps]
    assert ids[0] == ("remove", "0-1/1")
    assert plan.rebuilt.moves == fewest(standing(old), new) == 4
    assert plan.rebuilt.moves_bound == 3


@pytest.mark.parametrize(
    ("before", "after"), [((7, 4, 0), (9, 3, 4)), ((12, 5, 0), (9, 6, 4)), ((6, 3, 0), (6, 3, 7))]
)
def test_walls_become_others_in_few_moves_and_every_state_stands(before, after):
    old, new = planned(wall(*before)), planned(wall(*after))
    plan = rebuild(standing(old), new)
    assert plan.complete
    assert plan.rebuilt is not None
    assert plan.rebuilt.moves_bound <= plan.rebuilt.moves <= 1.1 * plan.rebuilt.moves_bound
    check_states(plan)
    made = [np.sort(b.vertices, axis=0) for b in standing(plan).finished.blocks]
    for block in standing(new).finished.blocks:
        assert any(np.allclose(np.sort(block.vertices, axis=0), one) for one in made)


def test_no_order_has_fewer_moves_than_the_bound():
    rng, met, least = np.random.default_rng(3), 0, 0
    while met < 12:
        old, new = random_bricks(rng), random_bricks(rng)
        if old is None or new is None:
            continue
        if len(standing(old).blocks) + len(standing(new).blocks) > 11:
            continue
        best, plan = fewest(standing(old), new), rebuild(standing(old), new)
        assert plan.rebuilt is not None
        assert best is not None
        assert plan.rebuilt.moves_bound <= best
        if plan.complete:
            assert best <= plan.rebuilt.moves
            least += plan.rebuilt.moves == best
            check_states(plan)
        met += 1
    assert least >= 10


def test_what_stood_from_the_start_is_in_the_file():
    block = box_block("a", (0, 0, 0), (1, 1, 1))
    whole = Assembly((block,), (AssemblyStep(remove="a"),))
    assert whole.at_first == (True,)
    with pytest.raises(InputError, match="a new one"):
        Assembly((block,), (AssemblyStep(remove="a"), *[AssemblyStep(place="a")] * 2))


def test_page_and_cards_tell_the_size_of_what_stands_in_the_end(tmp_path):
    tower, row = bricks(((0, 1),), ((0, 1),)), bricks(((4, 5), (6, 7), (8, 9)))
    plan = rebuild(standing(tower), row)
    write_plan_page(plan, tmp_path / "view.html")
    assert "3 blocks, 500 × 100 × 100 mm, 2 taken away," in (tmp_path / "view.html").read_text()
    cards = step_cards(standing(plan))
    assert "3 blocks in 5 steps and 1 layer, told on 5 cards" in cards
    assert "500 × 100 × 100 mm when the last step is done" in cards
    # What stays is told, too.
    stays = rebuild(standing(tower), bricks(((0, 1), (2, 3), (4, 5))))
    assert "3 blocks in 3 steps and 1 layer" in step_cards(standing(stays))


def test_nothing_is_said_to_stand_where_nothing_is_left(tmp_path):
    plan = rebuild(standing(bricks(((0, 1),))), bricks(((4, 5),)))
    assert [step.action for step in plan.steps] == ["remove", "place"]
    write_plan_page(plan, tmp_path / "view.html")
    page = (tmp_path / "view.html").read_text()
    assert re.search(r"N sideways, after step 2\b", page)
    first, second = re.findall(r"<tr data-step=.*?</tr>", page)
    assert "on bed faces" not in first
    assert "on bed faces" in second


def test_an_old_structure_that_stands_on_narrow_joints_alone_is_turned_into_another():
    """A brick that leans out by almost half, and a new wall that bears joints of centimetres."""
    plan = planned(wall(4, 2))
    assert plan.gap_range is not None
    assert plan.gap_range[1] > 0.005
    low, high = standing(plan).finished.blocks[0].vertices[[0, -1]]
    size = high - low
    upper = low + size * [0.48, 0, 1]
    kind = standing(plan).finished.blocks[0].kind
    boxes = [
        box_block("a", low, low + size, kind=kind),
        box_block("b", upper, upper + size, kind=kind),
    ]
    old = replace(standing(plan), blocks=tuple(boxes), steps=(), not_built=())
    assert check(old).verdict == "stands"
    made = rebuild(old, plan)
    assert made.complete
    assert made.gap_range is not None
    assert made.gap_range[1] < plan.gap_range[1]
    upper = low + size * [0.52, 0, 1]
    leaning = box_block("b", upper, upper + size, kind=kind)
    with pytest.raises(InputError, match="falls"):
        rebuild(replace(old, blocks=(boxes[0], leaning)), plan)


def test_what_cannot_be_turned_into_another_is_said():
    new = bricks(((0, 1),))
    leaning = Assembly((box_block("a", (0, 0, 0.5), (0.1, 0.1, 0.6)),))
    with pytest.raises(InputError, match="stands"):
        rebuild(leaning, new)
    large = Assembly((box_block("a", (0, 0, 0), (1, 1, 1), kind="1"),))
    with pytest.raises(InputError, match="the same kit"):
        rebuild(large, new)


def test_what_cannot_be_taken_away_or_placed_is_said():
    # Of two that lean on one another neither goes first; beside them there is room.
    half = np.array([(0, 0), (0.15, 0), (0.5, 0.4), (0.5, 0.5)])
    leaning = [
        hull_block(name, [(abs(far - x), y, z) for x, z in half.tolist() for y in (0, 0.1)])
        for name, far in (("left", 0.0), ("right", 1.0))
    ]
    old, new = Assembly(tuple(leaning)), bricks(((12, 13),))
    plan = rebuild(old, new)
    assert plan.reason == "no order without help: none of left, right can be taken away"


def test_the_command_line_turns_a_plan_into_another(tmp_path, capsys):
    for name, cells in (("old", wall(7, 3)), ("new", wall(6, 4, 4))):
        np.save(tmp_path / f"{name}.npy", cells)
    old, new = str(tmp_path / "old.npy"), str(tmp_path / "new.npy")
    kit = ("--kit", "bricks")
    assert main(["build", old, *kit, "--out", str(tmp_path / "old")]) == 0
    asked = ["build", new, *kit, "--from", str(tmp_path / "old" / "plan.json")]
    capsys.readouterr()
    assert main([*asked, "--json", "--out", str(tmp_path / "new")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["moves_bound"] <= told["moves"] <= told["taken"] + told["placed"]
    assert told["kept"] + told["placed"] == told["blocks"]
    made = Plan.load(tmp_path / "new")
    check_states(made)
    assert made.rebuilt is not None
    assert made.rebuilt.moves == told["moves"]
    cards = (tmp_path / "new" / "cards.html").read_text()
    assert re.search(r"Take block-\d+ away\.", cards), "no block is called block block-10"
    assert "It goes to its new place in the next step." in cards
    assert "Take away block" in (tmp_path / "new" / "view.html").read_text()
    # What stands already is not asked for again.
    told = instructions(standing(made))
    assert len(told.start) == int(sum(standing(made).at_first))
    needed = sum(line.built for line in told.bill)
    assert made.rebuilt.supplied <= needed <= made.rebuilt.placed


def test_an_old_mesh_has_the_unit_of_the_design_where_it_says_none(tmp_path):
    for name, high in (("old", 100), ("new", 0)):
        folder = tmp_path / name
        folder.mkdir()
        for k, low in enumerate(((0, 0, 0), (100 - high, 0, high))):
            box = trimesh.creation.box((50, 50, 100))
            box.apply_translation((*low[:2], low[2] + 50)).export(folder / f"b{k}.stl")
    plan = build(tmp_path / "new", old=tmp_path / "old", unit="mm", supports="none")
    assert plan.rebuilt is not None
    assert (plan.rebuilt.moves, plan.rebuilt.kept) == (1, 1)
    with pytest.raises(InputError, match=r"unit: got None.*old.* does not say it"):
        build(read_assembly(tmp_path / "new", unit="mm"), old=tmp_path / "old")


def test_a_drawing_is_filled_with_the_blocks_of_the_old_structure() -> None:
    kit = "bricks-lintels"
    old, alone = (build(cells, kit=kit) for cells in (wall(4, 3), wall(8, 1, 5)))
    new = build(wall(8, 1, 5), kit=kit, old=standing(old))
    told, other = new.rebuilt, rebuild(standing(old), alone).rebuilt
    assert told is not None
    assert other is not None
    assert (told.supplied, other.supplied) == (0, 1)
    assert told.moves < other.moves


def test_a_drawing_that_kinds_of_the_old_structure_do_not_fill_is_filled_with_the_others() -> None:
    kit = "bricks-lintels"
    old = build(wall(4, 2), kit=kit)
    assert {b.kind for b in standing(old).blocks} <= {"1x2", "1x4"}
    odd = build(wall(3, 1), kit=kit, old=standing(old))
    assert odd.complete, odd.reason
    assert odd.rebuilt is not None
    assert odd.rebuilt.supplied > 0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--arm", "panda", "--arm", "ur5e", "--physics", "kinematic"), "dynamic"),
        (("--kit", "planks"), "kind of block"),
        (("--from", "new.npy"), "unknown format"),
        (("--kit", "lego", "--cell", "8"), "clutch"),
        (("--holds", "1"), "holds: got 1, expected none: where a structure stands"),
        (("--hands",), "hands: got True, expected none: where a structure stands"),
        (("--supports", "posts"), "supports: got 'posts', expected auto or none: where a"),
        (("--supports", "props"), "supports: got 'props', expected auto or none: where a"),
    ],
)
def test_what_has_no_way_from_one_to_the_other_is_one_line(
    tmp_path, capsys, monkeypatch, more, said
):
    monkeypatch.chdir(tmp_path)
    np.save("new.npy", wall(6, 4, 4))
    np.save("old.npy", wall(7, 3))
    main(["build", "old.npy", "--kit", "bricks", "--out", "old"])
    capsys.readouterr()
    asked = ["build", "new.npy", "--kit", "bricks", "--from", "old", "--out", "new", *more]
    assert main(asked) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1
    assert said in lines[0]


def test_bricks_and_dry_blocks_are_not_turned_into_one_another():
    dry = bricks(((0, 1),))
    clutching = replace(standing(dry), joint=load_kit("lego").joint)
    with pytest.raises(InputError, match="dry blocks"):
        rebuild(clutching, dry)


def small_bricks(*rows: tuple[tuple[int, int], ...]) -> Plan:
    """As :func:`bricks`, of a size that a cup lifts: cells of 40 mm, nine about the origin."""
    blocks = [
        box_block(
            f"{a}-{b}/{z}",
            (a / 25 - 0.18, 0, z / 25),
            (b / 25 - 0.18, 0.04, (z + 1) / 25),
            kind=f"{b - a}",
        )
        for z, row in enumerate(rows)
        for a, b in row
    ]
    return build(Assembly(tuple(blocks)))


def test_an_arm_turns_one_structure_into_another() -> None:
    old, new = small_bricks(((0, 2), (4, 5)), ((0, 1),)), small_bricks(((0, 2),), ((0, 2),))
    plan = with_copies(rebuild(standing(old), new))
    done = carry_out(plan, Workcell("ur5e"), joint=0.0)
    assert done.complete, done.reason
    assert [step.action for step in done.steps] == ["remove", "remove", "place"]
    assert done.arm is not None
    assert (done.arm.attempts, done.blocks.used) == (3, 2)
    assert done.arm.error_worst is not None
    assert done.arm.error_worst < 1e-3
    assert done.coverage == 1
    check_states(done)
    assert {block.id for block in standing(done).finished.blocks} == {"0-2/0", "0-2/1"}
    # The record has every block where it was before its step, also that of the first one.
    assert done.record is not None
    for step in done.record.steps:
        assert np.abs(step.before[step.cells[0]] - step.after[step.cells[0]]).max() > 0.01
    was = {block.id: block.vertices.mean(0) for block in standing(old).blocks}
    first = done.record.steps[0]
    name = done.record.names[[cells[0] for cells in done.record.objects].index(first.cells[0])]
    assert np.abs(first.before[first.cells[0], :3] - was[name]).max() < 1e-3


def test_moves_of_a_plan_that_an_arm_has_carried_out_are_said_to_be_by_hand(capsys) -> None:
    old, new = small_bricks(((4, 5),), ((4, 5),)), small_bricks(((1, 2), (7, 8)))
    plan = with_copies(rebuild(standing(old), new))
    done = carry_out(plan, Workcell("panda", physics="kinematic"), joint=0.0)
    assert done.complete, done.reason
    # One after the other they go to a magazine, and come from there.
    assert [step.action for step in done.steps] == ["remove", "remove", "place", "place"]
    assert done.rebuilt == plan.rebuilt
    for one, said in ((plan, "2 moves (no order"), (done, "2 moves by hand (no order")):
        _print_plan(Output(as_json=False), one, {})
        assert said in capsys.readouterr().out


def test_what_leaves_and_comes_back_is_any_block_of_its_kind_for_an_arm() -> None:
    old, new = small_bricks(((0, 2),), ((0, 1),)), small_bricks(((0, 1),), ((0, 1),))
    plan = rebuild(standing(old), new)
    copied = with_copies(plan)
    assert len(standing(copied).blocks) == len(standing(plan).blocks) + 1
    assert [step.action for step in copied.steps] == [step.action for step in plan.steps]
    check_states(copied)
    done = carry_out(copied, Workcell("panda", physics="kinematic"), joint=0.0)
    assert done.complete, done.reason
    check_states(done)


def test_an_empty_magazine_gives_what_was_taken_away_to_it() -> None:
    old, new = small_bricks(((4, 5),), ((4, 5),)), small_bricks(((6, 7),))
    plan = with_copies(rebuild(standing(old), new))
    site = Site(magazines=(Magazine("1", Pose(0.0, -0.2, 0.0), 0),))
    done = carry_out(plan, Workcell("panda", site=site, physics="kinematic"), joint=0.0)
    assert done.complete, done.reason
    assert [step.action for step in done.steps] == ["remove", "remove", "place"]


def test_what_only_leaves_goes_to_the_magazine_of_a_layout() -> None:
    old, new = small_bricks(((4, 5),), ((4, 5),)), small_bricks(((4, 5),))
    plan = with_copies(rebuild(standing(old), new))
    site = Site(magazines=(Magazine("1", Pose(0.1, -0.25, 0.0), 0),))
    found = prepare(plan, Workcell("panda", site=site, physics="kinematic"), 0.0)
    assert [tuple(source.pose[:2]) for source in found.job.sources] == [(0.1, -0.25)]
    assert [step.remove for step in found.order.steps] == [True]


def test_what_leaves_where_blocks_wait_on_pallets_goes_to_a_magazine() -> None:
    old, new = small_bricks(((4, 5),), ((4, 5),)), small_bricks(((2, 3), (4, 5), (6, 7)))
    plan = with_copies(rebuild(standing(old), new))
    # One place, as one block is missing.
    site = Site(pallets=(Pallet("1", Pose(-0.1, -0.25, 0.0), 1, 1, (0.1, 0.1)),))
    cell = Workcell("panda", site=site, physics="kinematic")
    found = prepare(plan, cell, 0.0)
    assert [(s.magazine, s.left) for s in found.job.sources] == [(False, 1), (True, 0)]
    done = carry_out(plan, cell, joint=0.0, found=found)
    assert done.complete, done.reason
    assert [step.action for step in done.steps] == ["remove", "place", "place"]
    more = with_copies(rebuild(standing(old), small_bricks(((0, 1), (2, 3), (4, 5), (6, 7)))))
    with pytest.raises(InputError, match="1 of 2 1', expected places for all"):
        prepare(more, cell, 0.0)


def test_what_stays_and_is_pushed_over_is_put_back() -> None:
    old, new = small_bricks(((0, 2), (4, 5))), small_bricks(((0, 2),), ((0, 2),))
    plan = with_copies(rebuild(standing(old), new))
    found = prepare(plan, Workcell("panda", physics="kinematic"), 0.0)
    known = Choice(found.job, found.order, found.structure)
    kept = next(k for k in found.job.standing if StepOf(k, True) not in known.planned)
    assert known.world.state[kept] == STANDING
    known.world.state[kept] = LOOSE
    known.world.pose[kept, :3] = [0.25, 0.1, 0.02]
    action = known.choose()
    assert isinstance(action, Action)
    assert (action.block, action.what) == (kept, "place")


@pytest.mark.parametrize("dropped", [frozenset[int](), frozenset({1, 3})])
def test_what_is_pushed_or_dropped_meanwhile_does_not_end_it(dropped: frozenset[int]) -> None:
    old = small_bricks(((0, 2), (4, 5), (6, 8)), ((0, 1),))
    new = small_bricks(((0, 2), (6, 8)), ((0, 2),))
    plan = with_copies(rebuild(standing(old), new))
    pushed = Disturbance(push=frozenset({1, 2}), drop=dropped)
    cell = Workcell("ur5e", seed=1, noise=(3e-4, 2e-3), disturbance=pushed)
    done = carry_out(plan, cell, joint=0.0)
    assert done.complete, done.reason
    assert {block.id for block in standing(done).finished.blocks} == {"0-2/0", "6-8/0", "0-2/1"}
    assert done.arm is not None
    assert (done.arm.error_worst or 0) < 3e-3
    # What has to go is not put back to where it stood first.
    assert not any("place 0-1/1" in one.detail for one in done.arm.failures)


def two_arms(plan: Plan) -> list[Member]:
    assert plan.assembly is not None
    arms = [SiteArm(name, name) for name in ("ur5e", "panda")]
    return set_up_team(plan.assembly, arms, Site())


def test_what_stands_first_is_not_for_arms_that_hold() -> None:
    old, new = small_bricks(((0, 2), (4, 5))), small_bricks(((0, 2),), ((0, 2),))
    plan = with_copies(rebuild(standing(old), new))
    with pytest.raises(InputError, match="none, with arms that hold"):
        jobs_of(plan, two_arms(plan), Workcell("ur5e"), 0.0, holding=True)


def test_what_is_taken_away_leaves_from_above_whoever_does_it() -> None:
    old = small_bricks(((0, 2), (4, 6)), ((0, 1), (4, 5)))
    new = small_bricks(((1, 5),), ((1, 3),))
    plan = with_copies(rebuild(standing(old), new))
    found = prepare(plan, Workcell("ur5e", physics="kinematic"), 0.0)
    assert not found.order.stuck
    steps = {(step.block, step.remove): step for step in found.order.steps}
    known = Choice(found.job, found.order, found.structure)
    named = {piece.id: k for k, piece in enumerate(found.job.pieces)}
    low, high, other = (named[name] for name in ("0-2/0", "0-1/1", "4-5/1"))
    # What lies above comes first, what lies far away waits for nothing; what comes to that place
    # waits for all that was in it.
    waits = known.waits
    assert steps[high, True] in waits[steps[low, True]]
    assert steps[other, True] not in waits.get(steps[high, True], set())
    assert waits[steps[named["1-5/0"], False]] >= {steps[k, True] for k in (low, named["4-6/0"])}
    # The other arm has chosen one of the two on top: this one does not wait for that.
    known.elsewhere = {high}
    action = known.choose()
    assert isinstance(action, Action)
    assert (action.block, action.what) == (other, "remove")


def test_nothing_is_taken_away_while_another_arm_may_leave_it_unsupported() -> None:
    """A board on three posts stands on the middle one alone, and not on the last one."""
    ends = (0.0, 0.08, 0.16)
    posts = [box_block(f"{k}", (x, 0, 0), (x + 0.04, 0.04, 0.04)) for k, x in enumerate(ends)]
    board = box_block("board", (0, 0, 0.04), (0.2, 0.04, 0.08))
    new = build(Assembly((posts[0], posts[2], board)))
    found = prepare(
        with_copies(rebuild(Assembly((*posts, board)), new)),
        Workcell("ur5e", physics="kinematic"),
        0.0,
    )
    known = Choice(found.job, found.order, found.structure)
    named = {piece.id: k for k, piece in enumerate(found.job.pieces)}
    first = StepOf(named["0"], True)
    for elsewhere, bears in ((set[str](), True), ({"1"}, False), ({"2"}, True)):
        known.elsewhere = {named[name] for name in elsewhere}
        assert known.bears(first, known.standing()) == bears
    # But nothing is drawn out from below the board.
    middle = StepOf(named["1"], True)
    assert next(s for s in known.planned if s.remove) != middle


@pytest.mark.parametrize("noise", [(0.0, 0.0), (3e-4, 2e-3)])
def test_two_arms_turn_one_structure_into_another(
    noise: tuple[float, float], tmp_path: Path
) -> None:
    old = small_bricks(((0, 2), (4, 6), (7, 9)), ((0, 1), (4, 5)))
    new = small_bricks(((1, 5), (7, 9)), ((1, 3), (3, 5)), ((2, 4),))
    done = build(
        replace(new.assembly or Assembly(()), steps=()),
        old=standing(old),
        arm=("ur5e", "panda"),
        noise=noise,
        seed=2,
    )
    assert done.complete, done.reason
    ids = {block.id.rstrip("'") for block in standing(done).finished.blocks}
    assert ids == {"1-5/0", "7-9/0", "1-3/1", "3-5/1", "2-4/2"}
    check_states(done)
    did = [one.did for one in done.arms]
    assert all(one is not None and one.attempts > 0 for one in did)
    assert sum(one.attempts for one in did if one) >= len(done.steps)
    assert max(one.error_worst or 0 for one in did if one) < (1e-3 if not any(noise) else 3e-3)
    if not any(noise):
        # What the other arm carries away is no disturbance.
        assert not any(one.failures for one in did if one)
        # Nor is it for who plays what one of them has done.
        for who, arm in enumerate(("ur5e", "panda")):
            records = done.records[who], done.records[1 - who]
            file = export_program(records, "csv", tmp_path / f"{arm}.csv").file
            assert replay_program(file, arm).same


def test_an_arm_that_has_nothing_to_do_is_waited_for_by_nobody(tmp_path: Path) -> None:
    old, new = (
        Assembly(tuple(box_block(n, (x, 0, z), (x + 0.1, 0.05, z + 0.05)) for n, x, z in places))
        for places in ((("a", 0, 0), ("b", 0, 0.05)), (("a", 0, 0),))
    )
    done = build(new, old=old, arm=("panda", "ur5e"))
    assert done.complete, done.reason
    (idle,) = (n for n, arm in enumerate(done.arms) if arm.did and not arm.did.attempts)
    did = done.arms[idle].did
    assert did is not None
    assert did.error_worst is None
    done.save(tmp_path, page=False)
    for name in (f"trajectory-{2 - idle}.json", ""):
        out = tmp_path / f"{name or 'both'}.csv"
        told = export_program(tmp_path / name, "csv" if name else "ros2", out)
        assert told.waits is None
    with pytest.raises(InputError, match="no motion"):
        export_program(tmp_path / f"trajectory-{1 + idle}.json", "csv", tmp_path / "idle.csv")


def test_an_arm_keeps_every_state_standing_in_its_own_order() -> None:
    kit, rng, tried = load_kit("cubes"), np.random.default_rng(28), 0
    while tried < 6:
        cells = [np.zeros((5, 1, 4), bool) for _ in range(2)]
        for one in cells:
            for x, high in enumerate(rng.integers(0, 4, 5).tolist()):
                one[x, 0, :high] = True
        if not all(one.any() for one in cells):
            continue
        old = build(cells[0], kit=kit)
        plan = build(cells[1], kit=kit, old=standing(old))
        if not plan.complete:
            continue
        tried += 1
        plan = with_copies(plan)
        found = prepare(plan, Workcell("ur5e", physics="kinematic"), kit.joint_gap)
        assert not found.order.stuck
        assert set(found.order.steps) == set(found.job.steps)
        there = set(found.job.standing)
        for step in found.order.steps:
            assert (step.block in there) == step.remove
            there ^= {step.block}
            assert not any(found.structure.overlaps[k] & there for k in there)
            blocks = tuple(standing(plan).blocks[k] for k in sorted(there))
            whole = replace(standing(plan), blocks=blocks, steps=(), not_built=())
            assert not blocks or check(whole).verdict != "falls"


def test_an_arm_has_nothing_to_do_where_all_stays() -> None:
    wall_ = small_bricks(((0, 2),), ((0, 1), (1, 2)))
    plan = rebuild(standing(wall_), wall_)
    done = carry_out(with_copies(plan), Workcell("ur5e", physics="kinematic"), joint=0.0)
    assert (done.status, done.steps) == ("complete", ())


def test_what_an_order_does_not_come_to_is_not_built() -> None:
    old, new = bricks(((0, 1), (2, 3))), bricks(((0, 1), (2, 3)), ((0, 3),))
    plan = rebuild(standing(old), new, seconds=60.0)
    first = standing(plan).at_first
    names = [b.id for b, here in zip(standing(plan).blocks, first, strict=True) if here]
    assert sorted(names) == ["0-1/0", "2-3/0"]
    cut = rebuild(standing(old), new, seconds=1e-9)
    names = [b.id for b in standing(cut).blocks]
    there = {n for n, here in zip(names, standing(cut).at_first, strict=True) if here}
    assert there == {"0-1/0", "2-3/0"}
