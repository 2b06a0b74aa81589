"""Measured figures: each measured once, kept, told beside what was asked, true in the documents."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

import learn2assemble as l2a
from cell_shapes import SHAPES
from l2a_lab import builds, creep, goals, hidden, sensing, shapes, speed, two_arms_bricks
from l2a_lab import designs as design_figures
from l2a_lab import structures as figures
from l2a_lab.__main__ import command_line
from l2a_lab.arm_distances import MOMENTS
from l2a_lab.builder.measure import BUDGETS, complete_told
from l2a_lab.builder.search import RULES
from l2a_lab.curves import WITH_ROBOT, costs_told, hours_told
from l2a_lab.measured import measure
from l2a_lab.meshes import MESHES, mesh_table
from l2a_lab.numbers import load_table
from l2a_lab.rebuilding import CARRIED
from l2a_lab.report import losses_told
from l2a_lab.states import (
    count_states,
    every,
    largest_move,
    largest_moves,
    opened,
    states_of,
    upright,
)
from l2a_lab.tables import get_table
from l2a_lab.two_arms import EIGHT, holds_told, stops_told, table
from learn2assemble.acting.carry_out import Workcell, prepare
from learn2assemble.acting.report import deepest_overlap
from learn2assemble.assembly.blocks import Assembly, AssemblyStep
from learn2assemble.assembly.boxes import box_block
from learn2assemble.assembly.kit import load_kit
from learn2assemble.cli import main
from learn2assemble.design.cells import CellDesign
from learn2assemble.errors import InputError, MissingExtraError
from learn2assemble.planning.tiling.construct import plan_cells
from learn2assemble.planning.tiling.cover.tile import Tiling
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.planning.tiling.props import choose_props, unsupported
from learn2assemble.robot.bodies import Part, solids
from learn2assemble.tasks.task import HIDDEN_TASKS
from test_tiling import LINTELS, SMALL, blocks_of, covers, designs

ROOT = Path(__file__).parents[2]


def test_entries_are_measured_once_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "structures.json"
    call = ["measure-structures", "--out", str(out), "--only", "arch, 9 voussoirs"]
    assert main([*call, "--json"], command_line()) == 0
    rows = {what: got for what, _, got in json.loads(capsys.readouterr().out)["rows"]}
    assert "complete, 2 posts and 0 held" in rows["arch, 9 voussoirs"]
    assert "complete, 0 posts and 2 held" in rows["arch, 9 voussoirs, one hold"]
    kept = json.loads(out.read_text())
    names = {n for n in figures.names() if "arch, 9 voussoirs" in n}
    assert set(kept["entries"]) == names
    for name in ("arch, 9 voussoirs", "arch, 9 voussoirs, one hold"):
        one = kept["entries"][f"states/{name}"]
        assert one["simulated"] == one["states"] > 9
        assert one["largest_move_m"] <= figures.LIMIT
    monkeypatch.setattr(figures, "order_entry", lambda *_: pytest.fail("measured again"))
    assert measure(figures.FIGURES, out, only="order/arch, 9 voussoirs") == kept


def test_figures_are_told_with_what_is_missed() -> None:
    pile = {"status": "complete", "largest_move_m": 2e-4, "largest_move_all_faces_m": 5e-3}
    posts = {"status": "complete", "posts": 3}
    rows = figures.summary(
        {
            "pile/0": pile,
            "pile/11": {**pile, "status": "incomplete"},
            "posts/4": {**posts, "fewest_posts": 2},
            "posts/5": {**posts, "fewest_posts": 3},
            "posts/6": {**posts, "fewest_posts": None},
        }
    )
    told = {what: got for what, _, got in rows}
    assert told["piles"] == "1 of 2 with every state proven; not: 11"
    assert told["MuJoCo: piles"] == "0.200 mm at most; more in: none"
    assert told["MuJoCo: piles, all faces"] == "5.000 mm at most; more in: 0, 11"
    assert told["fewest posts"] == "1 of 2; not: 4"


def pair() -> Assembly:
    """A block on a prop, held while the prop goes: not to be built so, but to be counted."""
    blocks = (box_block("b", (0, 0, 1), (1, 1, 2)), box_block("p", (0, 0, 0), (1, 1, 1), prop=True))
    steps = [{"place": "p"}, {"place": "b"}, {"hold": "b"}, {"remove": "p"}, {"release": "b"}]
    return Assembly(blocks, tuple(AssemblyStep(**step) for step in steps))


def test_states_have_props_as_blocks_and_what_is_held_as_supports() -> None:
    states = list(states_of(pair()))
    assert count_states(pair()) == len(states)
    assert [[b.id for b in state.blocks] for state in states] == [["p"], ["b", "p"], ["b"], ["b"]]
    assert [[b.support for b in state.blocks] for state in states] == [
        [False],
        [True, False],
        [True],
        [False],
    ]
    assert not any(b.prop for state in states for b in state.blocks)
    moves = largest_moves(pair(), gap=0.0, seconds=0.5)
    assert max(moves[:3]) < 1e-5
    assert moves[3] > 0.5  # Nothing carries it any more.
    assert len(largest_moves(pair(), gap=0.0, seconds=0.01, most=2)) == 2


def test_faces_are_drawn_in_by_half_a_joint() -> None:
    wide, deep = (opened(pair(), 0.02, which) for which in (upright, every))
    for made, z in ((wide, (1.0, 2.0)), (deep, (1.01, 1.99))):
        ends = np.array([made.blocks[0].vertices.min(0), made.blocks[0].vertices.max(0)])
        np.testing.assert_allclose(ends, [[0.01, 0.01, z[0]], [0.99, 0.99, z[1]]], atol=1e-12)


def test_the_table_of_meshes_is_that_of_the_results() -> None:
    entries = json.loads((ROOT / "results" / "structures.json").read_text())["entries"]
    page = (ROOT / "docs" / "bricks.md").read_text(encoding="utf-8")
    assert mesh_table(entries) in page
    for one in (entries[f"mesh/{name}"] for name in MESHES):
        assert one["ldraw_steps"] == one["placed"]
        stands = one["check_verdict"] == "stands"
        assert stands == (one["status"] == "complete") == (one["placed"] == one["bricks"])


# Of the exact planner.


def test_what_two_arms_save_on_pairs_is_that_of_the_file() -> None:
    entries = json.loads((ROOT / "results" / "structures.json").read_text())["entries"]
    both = [(entries[f"carried/{seed}"], entries[f"carried-two/{seed}"]) for seed in range(CARRIED)]
    shares = [two["robot_s"] / one["robot_s"] for one, two in both]
    told = f"take {min(shares):.2f} to {max(shares):.2f} of the time of one, {np.mean(shares):.2f}"
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert told in text
    every = [one for pair in both for one in pair]
    assert all(one["status"] == "complete" and not one["states_that_fall"] for one in every)
    more = sum(one["attempts"] - one["steps"] for one in every)
    off = 1e3 * max(one["error_worst"] for one in every)
    assert f"(in all ten builds {more} more), and no block is farther than {off:.2f} mm" in text


def test_designs_are_measured_once_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "designs.json"
    call = ["measure-designs", "--out", str(out), "--only", "/arch-4"]
    assert main([*call, "--json"], command_line()) == 0
    rows = {what: got for what, _, got in json.loads(capsys.readouterr().out)["rows"]}
    assert rows["shapes built"] == "1 of 1; not: none"
    assert rows["limited heap"] == "1 of 1"
    proven = rows["step proofs, second solver"].split()
    assert proven[0] == proven[2] != "0"
    before = json.loads(out.read_text())
    assert set(before["entries"]) == {"shape/arch-4", "heap/arch-4", "proofs/arch-4"}
    assert before["configuration"]["seed"] == design_figures.SEED
    monkeypatch.setattr(design_figures, "shape_entry", lambda *_: pytest.fail("measured again"))
    assert measure(design_figures.FIGURES, out, only="shape/arch-4") == before
    with pytest.raises(InputError, match="--only"):
        measure(design_figures.FIGURES, out, only="no such thing")
    out.write_text("{}")
    with pytest.raises(InputError, match="--out"):
        measure(design_figures.FIGURES, out, only="shape/arch-4")
    assert out.read_text() == "{}"


@settings(max_examples=40, deadline=None)
@given(wanted=designs((4, 2, 3)))
def test_no_tiling_takes_fewer_props_than_the_bound(wanted: np.ndarray) -> None:
    least = design_figures.least_props(wanted, SMALL)
    for number, picked in enumerate(covers(wanted, SMALL)):
        if number >= 40:
            break
        tiling = Tiling(blocks_of(wanted, SMALL, picked), wanted)
        demands = {block: frozenset((block,)) for block in unsupported(tiling, SMALL)}
        props = choose_props(tiling, SMALL, demands)
        assert props is None or len(props) >= least


def test_the_bound_is_reached_by_a_bridge() -> None:
    wanted = shapes.SHAPES["bridge-long"]()
    tiling, _ = plan_exact(wanted, LINTELS)
    props = sum(block.prop for block in tiling.placements)
    assert design_figures.least_props(wanted, LINTELS) == props == 6
    assert design_figures.least_props(shapes.SHAPES["arch-8"](), LINTELS) == 0


def test_the_simulation_tells_what_stands() -> None:
    from learn2assemble.planning.tiling.cover.candidates import BlockPlacement
    from learn2assemble.planning.tiling.ordering import to_assembly

    wanted = np.zeros((4, 1, 2), bool)
    wanted[:1, :, 0] = wanted[:, :, 1] = True
    blocks = (BlockPlacement("1x1", 0, (0, 0, 0)), BlockPlacement("1x4", 0, (0, 0, 1)))
    falls = to_assembly(Tiling(blocks, wanted), None, LINTELS)
    stands = to_assembly(Tiling(blocks[:1], wanted), None, LINTELS)
    assert largest_move(falls, 1.0) > 0.01
    assert largest_move(stands, 1.0) < 1e-3


# What cameras tell.


def test_every_kind_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensing, "SAMPLES", 2)
    rig = "one camera"
    alone = sensing.entry(f"alone/{sensing.BRICKS}/{rig}")
    assert alone["seen"] == 2
    assert alone["mm"][0] < 1
    lost = sensing.entry(f"lost/two bricks beside a wall/{rig}")
    assert lost["samples"] == 2 >= lost["found"] >= lost["wrong"] == 0
    once = sensing.entry(f"calibrated/0/{rig}")
    assert once["after_mm"] < 3 < once["before_mm"]
    look = sensing.entry(f"look/40 bricks/{rig}")
    assert 0 < look["seen"] <= 40
    names = (f"alone/{sensing.BRICKS}/{rig}", f"lost/x/{rig}", f"calibrated/0/{rig}")
    rows = sensing.summary(dict(zip(names, (alone, lost, once), strict=True)))
    assert [what.split(":")[0].split(",")[0] for what, _, _ in rows] == [
        "alone",
        "lost",
        "calibrated",
    ]
    assert set(map(len, rows)) == {3}


def test_scenes_have_no_blocks_in_one_another() -> None:
    import numpy as np

    from learn2assemble.robot.bodies import overlaps, solids

    for make in sensing.SCENES.values():
        true, others = make(np.random.default_rng(0), sensing.BRICK)
        every = [solids(*one) for one in [(sensing.BRICK, true), *others]]
        assert not any(overlaps(a, b, 1e-6) for k, a in enumerate(every) for b in every[:k])


# Steps a second beside another library: what is counted are steps.


def test_all_are_measured_by_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def counted(name: str):
        def measure(seconds: float) -> float:
            assert seconds == speed.SECONDS
            calls.append(name)
            return 100.0 * len(calls)

        return measure

    monkeypatch.setattr(speed, "MEASURED", {name: counted(name) for name in "ab"})
    found = speed.entry(speed.RUN)
    assert calls == ["a", "b"] * speed.TURNS
    assert found["a"] == {"median": 500, "lowest": 100, "highest": 900}
    assert speed.summary({speed.RUN: found}) == [
        ("a", "say", "500 a second"),
        ("b", "say", "600 a second"),
    ]
    assert speed.summary({}) == []


def test_the_vector_environment_steps_all_its_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[int] = []

    def once(step, seconds: float) -> float:
        steps.append(step())
        return 1.0

    monkeypatch.setattr(speed, "rate", once)
    assert speed._vector(1.0) == 1.0
    assert steps == [speed.BATCH]


def test_the_other_library_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str):
        raise ImportError(name)

    monkeypatch.setattr(speed.importlib, "import_module", absent)
    with pytest.raises(MissingExtraError, match="speed"):
        speed._packing(1)(1.0)


def test_the_table_of_speeds_is_that_of_the_file() -> None:
    root = Path(__file__).resolve().parents[2]
    entries = json.loads((root / "results" / "speed.json").read_text(encoding="utf-8"))["entries"]
    text = (root / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## Speed of the environments\n")[1].split("\n## ")[0]
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert rows == speed.table(entries).splitlines()


def test_figures_of_the_first_page_are_those_of_the_tables() -> None:
    """And all that it has of the paper's tables."""
    with (ROOT / "results" / "tables.csv").open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))

    def found(table: str, task: str, method: str, physics: str = "static") -> dict[str, str]:
        condition = (table, task, method, "0.05", physics)
        keys = ("table", "task", "method", "epsilon", "physics")
        (line,) = (one for one in lines if tuple(one[key] for key in keys) == condition)
        assert line["agents"] == "5"
        return line

    def shown(line: dict[str, str], name: str) -> str:
        return f"{float(line[name]):.2f} ± {float(line[f'{name}_ci95']):.2f}"

    small, large = "two-sided-3x3-20-24", "two-sided-5x5-40-44"
    search = "DQN+MCTS, budget 10"
    plain, with_it = (found("T2", small, f"{m}, paper's schedule") for m in ("DQN", search))
    zero_shot = "ours, trained on 3x3, budget 10 (model labels)"
    ours, published = (found("T2", large, m) for m in (zero_shot, f"{search}, paper's schedule"))
    rows, anywhere = (
        ("T4", "robot-two-sided-3x3-10-14"),
        (
            "T4-random",
            "robot-random-two-sided-3x3-10-14",
        ),
    )
    arm = [
        [found(*place, f"{m}, paper's schedule", "published") for place in (rows, anywhere)]
        for m in (search, "DQN")
    ]
    there, here = (
        [" → ".join(f"{float(one[key]):.2f}" for one in pair) for pair in arm]
        for key in ("paper_R", "R")
    )
    look = [one for one in lines if one["method"] == "exact look-ahead (knows outcomes)"]
    (share,) = (
        float(one["of_bound"])
        for one in look
        if (one["table"], one["task"], one["epsilon"]) == ("T2", small, "0")
    )
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    own = text.split("## The paper, reproduced\n")[1].split("\n## ")[0]
    for words in (
        f"scores {shown(plain, 'R')} without search and {shown(with_it, 'R')} with it",
        f"(paper: {shown(plain, 'paper_R')}, {shown(with_it, 'paper_R')})",
        f"{shown(ours, 'R')} with search (paper: {shown(published, 'paper_R')})",
        f"{here[0]} with search (paper: {there[0]}), {here[1]} without ({there[1]})",
        f"reaches {share:.0%} of the bound".replace("%", " %"),
    ):
        assert words in own, words


# Builds by an arm: every entry once, and what is no result is refused.


def test_every_measurement_has_a_name_of_its_own() -> None:
    names = builds.names()
    assert len(names) == len(set(names))
    count = len(builds.DESIGNS) * len(builds.ARMS)
    assert sum(name.startswith("noise/") for name in names) == builds.SEEDS * count == 160


def test_what_was_measured_is_not_measured_again(tmp_path: Path) -> None:
    calls: list[str] = []

    def fake(name: str) -> dict[str, Any]:
        calls.append(name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return {"status": "complete", "reason": None}

    figures = replace(builds.FIGURES, entry=fake)
    out = tmp_path / "builds.json"
    with pytest.raises(KeyboardInterrupt):
        measure(figures, out, only="pyramid.json/panda")
    first = set(json.loads(out.read_text())["entries"])
    assert len(first) == 2
    calls[:] = [""] * 3
    found = measure(figures, out, only="pyramid.json/panda")
    assert not first & set(calls)
    assert set(found["entries"]) == {n for n in builds.names() if "pyramid.json/panda" in n}
    rows = builds.summary(found["entries"])
    got = {what: (asked, words) for what, asked, words in rows}
    assert got["noise"][0] == ">= 95 %, <= 2 mm"
    assert got["noise"][1].startswith("10 of 10; off by 0.00 mm")
    assert {"faults", "guarded", "coarse/touch", "coarse/blind", "worse"} <= got.keys()


def test_other_files_are_not_overwritten(tmp_path: Path) -> None:
    out = tmp_path / "builds.json"
    out.write_text("{}")
    with pytest.raises(InputError, match="--out"):
        measure(builds.FIGURES, out, only="pyramid")
    assert out.read_text() == "{}"
    with pytest.raises(InputError, match="--only"):
        measure(builds.FIGURES, tmp_path / "new.json", only="pyramdi")


@pytest.mark.slow
def test_a_small_example_is_built_and_its_program_played() -> None:
    found = builds.entry("program/arch_pair.json/panda")
    assert found["status"] == "complete"
    assert found["program"]["same"]
    assert found["program"]["worst"] < 2e-3
    assert found["attempts_per_step"] >= 1


def test_contacts_give_more_under_more_weight() -> None:
    """By Hooke, as long as they give by little: that is what blocks at rest are in one another."""
    gives = []
    for count in (2, 4):
        cells = np.ones((1, 1, 2 * count), bool)
        kit = load_kit("cubes").at_pitch((0.04, 0.04, 0.04))
        design = CellDesign("tower", cells, kit.pitch, None, 0.0, None, "", None)
        plan = plan_cells(design, kit)
        job = prepare(plan, Workcell("ur5e", "suction"), kit.joint_gap).job
        found = builds._gives(job)
        assert found is not None
        gives.append(found)
    assert 0 < gives[0] < gives[1] < 1e-4


def test_the_deepest_overlap_is_that_of_the_nearest_two() -> None:
    box = (Part((0.0, 0.0, 0.0), (0.01, 0.01, 0.01)),)
    poses = [np.array([x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) for x in (0.0, 0.0197, 0.1)]
    bodies = [solids(box, pose) for pose in poses]
    overlap = deepest_overlap(bodies)
    assert overlap is not None
    assert math.isclose(overlap, 3e-4, abs_tol=1e-9)
    assert deepest_overlap(bodies[1:]) is None


# The sweep of hidden errors: what is measured, and the table of the page.


@pytest.fixture(scope="module")
def entries() -> dict:
    text = (ROOT / "results" / "hidden.json").read_text(encoding="utf-8")
    return json.loads(text)["entries"]


def test_the_table_of_hidden_errors_is_that_of_the_file(entries: dict) -> None:
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    assert set(entries) == set(hidden.names())
    assert hidden.page_table(entries) in page
    sturdiest = entries[f"{HIDDEN_TASKS[hidden.TASK].factor:g}/sturdiest first"]
    assert f"completes {sturdiest['completed']} of the {hidden.COUNT}" in page


def test_the_planner_with_repair_completes_what_was_asked(entries: dict) -> None:
    share = {name: one["completed"] / hidden.COUNT for name, one in entries.items()}
    assert 0.6 <= share[f"{HIDDEN_TASKS[hidden.TASK].factor:g}/with repair"] <= 0.8
    assert share["0/with repair"] == 1
    swept = [share[f"{factor:g}/with repair"] for factor in hidden.FACTORS]
    assert swept == sorted(swept, reverse=True)


@pytest.mark.parametrize("who", ["with repair", "sturdiest first"])
def test_a_measurement_counts_what_happens(who: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden, "COUNT", 1)
    found = hidden.entry(f"0/{who}")
    assert found == {"score": 1.0, "completed": 1, "falls": 0, "collisions": 0}
    assert hidden.summary({f"0/{who}": found}) == [(f"0/{who}", "say", "100% of 1, score 1.000")]


# Two arms beside one: what the documents say is what was measured.

TWO_ARMS: dict[str, Any] = json.loads(
    (ROOT / "results" / "two_arms.json").read_text(encoding="utf-8")
)["entries"]


def test_the_table_of_two_arms_is_that_of_the_file() -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## Two arms\n")[1].split("\n## ")[0]
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert rows == table(TWO_ARMS).splitlines()
    assert stops_told(TWO_ARMS) in own
    assert holds_told(TWO_ARMS) in own
    assert holds_told(TWO_ARMS, "arch of 21") in own
    assert holds_told(TWO_ARMS, "vault of 45") in own
    assert holds_told(TWO_ARMS, "dome of 60") in own
    assert holds_told(TWO_ARMS, kind="noise") in own


def test_the_table_of_builders_is_that_of_the_file() -> None:
    text = (ROOT / "docs" / "methods" / "builder.md").read_text(encoding="utf-8")
    sets = json.loads((ROOT / "results" / "designs_agent.json").read_text())["sets"]
    assert "\n".join(complete_told(sets)) in text
    # What the sentences behind it say.
    played = sets["bricks-lintels, up to 60 blocks"]["players"]
    most, best = (
        played["builder-s0"]["with search"],
        [played[rule]["with search"] for rule in RULES],
    )
    assert max(abs(most["complete"] - one["complete"]) for one in best[:2]) < 0.02
    fewer = [
        most["blocks_per_block_of_exact"] / one["blocks_per_block_of_exact"] for one in best[:2]
    ]
    assert all(round(100 * (1 - share)) == 3 for share in fewer)
    cubes = sets["cubes, up to 60 blocks"]["players"].values()
    assert all(one[how]["complete"] == 1 for one in cubes for how in BUDGETS)
    large = sets["bricks-lintels, 200 to 400 blocks"]["players"].values()
    assert all(one["with search"]["complete"] == 1 for one in large)


def test_what_trainings_cost_is_that_of_their_logs() -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## What training with a robot costs\n")[1].split("\n## ")[0]
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert rows == costs_told(WITH_ROBOT, ROOT / "results" / "runs.jsonl.gz")
    assert hours_told(WITH_ROBOT, ROOT / "results" / "runs.jsonl.gz") in own


def test_what_agents_lose_where_blocks_wait_anywhere_is_that_of_the_tables() -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## Blocks in rows, and anywhere\n")[1].split("\n## ")[0]
    rows, anywhere = (load_table(get_table(name), ROOT / "results") for name in ("T4", "T4-random"))
    told = losses_told(rows, anywhere)
    assert [line for line in own.splitlines() if line.startswith("|")] == told
    assert len(told) > 4


def test_the_table_of_bricks_is_that_of_the_file() -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    own = text.split("## Two arms and bricks\n")[1].split("\n## ")[0]
    rows = [line for line in own.splitlines() if line.startswith("|")]
    assert rows == two_arms_bricks.table(TWO_ARMS).splitlines()


def test_the_eight_have_as_many_blocks_as_is_said() -> None:
    told = {name: one for name, one in TWO_ARMS.items() if name.startswith("eight/")}
    assert told
    assert {name.split("/")[1] for name in told} <= set(EIGHT)
    assert all(40 <= one["blocks"] <= 100 for one in told.values())
    assert all(one["moments"] == MOMENTS for one in told.values() if "moments" in one)


def test_bricks_of_two_arms_are_told_beside_one_after_the_other() -> None:
    def one(seconds: float, in_turn: float) -> dict[str, Any]:
        told = {"status": "complete", "blocks": 5, "robot_s": seconds, "in_turn_s": in_turn}
        return told | {"least_distance": 0.0213, "reason": None}

    refused = {"status": "refused", "reason": "why"}
    entries = {
        **{"bricks/apex_R/both": one(30.0, 50.0), "bricks/apex_R/panda": one(60.0, 0.0)},
        **{"bricks/apex_rss/both": one(40.0, 50.0), "bricks/apex_cliff/both": refused},
        # A wall of our own does not count to the mean.
        f"bricks/{two_arms_bricks.WALL}/both": one(10.0, 50.0),
        **{"bricks/apex_R/both, socket": one(29.0, 50.0)},
    }
    assert two_arms_bricks.table(entries).splitlines()[2:] == [
        "| apex_R | gripper | 5 | 30.0 | 50.0 | 0.60 | 60.0 | 21.3 |",
        "| apex_cliff | gripper |  | refused |  |  |  |  |",
        "| apex_rss | gripper | 5 | 40.0 | 50.0 | 0.80 |  | 21.3 |",
        "| wall of bricks | gripper | 5 | 10.0 | 50.0 | 0.20 |  | 21.3 |",
        "| mean of 2 tasks of APEX-MR | gripper |  |  |  | 0.70 |  |  |",
        "| apex_R | socket | 5 | 29.0 | 50.0 | 0.58 |  | 21.3 |",
        "| mean of 1 task of APEX-MR | socket |  |  |  | 0.58 |  |  |",
    ]
    rows = two_arms_bricks.summary(entries)
    assert ("<= 0.52 mean", "0.70 mean of 2") in [row[1:] for row in rows]
    assert rows[-1][1:] == ("<= 0.52 mean", "0.58 mean of 1")
    assert [got for what, _, got in rows if what == "apex_cliff, gripper"] == ["refused (why)"]


def test_the_wall_of_bricks_is_in_bond() -> None:
    bricks = two_arms_bricks.wall(12, 3)
    wide = [round(float(np.ptp(block.vertices[:, 0])), 3) for block in bricks.blocks]
    assert wide == [0.032] * 3 + [0.016, 0.032, 0.032, 0.016] + [0.032] * 3
    assert l2a.check(bricks).verdict == "stands"


def test_the_table_says_what_no_arm_builds_alone() -> None:
    def one(status: str, seconds: float) -> dict[str, Any]:
        return {"status": status, "robot_s": seconds, "blocks": 50, "least_distance": 0.0213}

    found = table(
        {
            "eight/bridge/ur5e": one("complete", 100.0),
            "eight/bridge/panda": one("complete", 80.0),
            "eight/bridge/both": one("complete", 50.0),
            "eight/dome/both": one("complete", 50.0),
            "eight/keep.json/both": one("incomplete", 10.0),
        }
    ).splitlines()
    assert found[2:] == [
        "| keep.json | 50 | incomplete |  |  |  |",
        "| bridge | 50 | 50.0 | 80.0 | 0.62 | 21.3 |",
        "| dome | 50 | 50.0 | no arm alone |  | 21.3 |",
        "| mean of 1 of the eight |  |  |  | 0.62 |  |",
    ]


def test_figures_of_goals_count_what_was_measured() -> None:
    names = goals.names()
    assert len(names) == len(set(names)) == 2 * 55 + 50
    entries: dict[str, Any] = {name: {"status": "complete", "blocks": 6} for name in names}
    entries |= {n: {"status": "refused", "blocks": 0} for n in names if "/impossible/" in n}
    entries |= {n: {"status": "optimal", "blocks": 5} for n in names if n.startswith("optimum/")}
    entries["search/planar/arch/20000"] = {"status": "incomplete", "blocks": 0}
    rows = {what: got for what, _, got in goals.summary(entries)}
    assert rows["search: planar tasks solved"] == "29 of 30; not: planar/arch/20000"
    assert rows["search: spatial tasks solved"].startswith("20 of 20")
    assert rows["program: impossible tasks"].startswith("0 complete, 5 of 5 refused")
    words = rows["search: planar blocks by the optimum, where it is known"]
    assert words == "1.200 on average, 1.20 at most, 29 of 29 above"


# ---------------------------------------------------------------- blocks of an MJCF


@pytest.mark.parametrize("gap", [0.0, 1e-4])
def test_blocks_of_an_mjcf_stay_where_they_are(gap: float) -> None:
    """A wall of ten layers in running bond, with and without joints."""
    blocks = []
    for layer in range(10):
        ends = [0.0, *np.arange(0.1 if layer % 2 else 0.05, 0.3, 0.1), 0.3]
        for k, (begin, end) in enumerate(pairwise(ends)):
            low, high = (begin + gap / 2, 0.0, 0.05 * layer), (end - gap / 2, 0.05, 0.05 * layer)
            blocks.append(box_block(f"{layer}-{k}", low, (*high[:2], high[2] + 0.05)))
    assert largest_move(Assembly(tuple(blocks)), 1.0) < 0.3 * creep.LIMIT


@pytest.mark.parametrize("gap", creep.GAPS)
@pytest.mark.parametrize("name", ["bridge", "long bridge on its props"])
def test_structures_and_their_props_stay_where_they_are(name: str, gap: float) -> None:
    """At any time, the first instants included; ``l2a-lab measure-designs --only creep/``
    looks for 20 s."""
    made = creep.structure(name, gap)
    props = sum(block.id.startswith("prop") for block in made.blocks)
    assert bool(props) == creep.CASES[name].props
    assert largest_move(made, 3.0) < 0.3 * creep.LIMIT


def test_shapes_of_the_tests_are_those_that_are_measured() -> None:
    """Tests of the product, which know no laboratory, read them from a file."""
    made = {name: make() for name, make in shapes.SHAPES.items()}
    made["house-big"] = shapes.big_house()
    assert SHAPES.keys() == made.keys()
    for name, cells in made.items():
        assert np.array_equal(SHAPES[name], cells), name
