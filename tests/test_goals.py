"""Goals without a drawing: what is called complete meets them, what is impossible never is."""

from __future__ import annotations

import json
import math
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import learn2assemble as l2a
from learn2assemble.assembly.boxes import box_block
from learn2assemble.cli import main
from learn2assemble.design.goals import Goals, parse_goals, read_goals
from learn2assemble.errors import InputError
from learn2assemble.planning.goals.planner import EXACT, SEARCH, WAYS, plan_goals, prepare
from learn2assemble.planning.goals.program import ProgramResult, find_order, plan_program
from learn2assemble.planning.goals.search import Found, finished, search
from learn2assemble.planning.goals.stacks import find_stacks
from learn2assemble.planning.goals.world import make_problem
from learn2assemble.planning.plan import Plan
from learn2assemble.planning.tiling.cover.candidates import placement_cells
from learn2assemble.planning.tiling.exact import plan_exact
from learn2assemble.statics.rigid_blocks import check
from learn2assemble.tasks.goals import (
    FAMILIES,
    FIRST_FIXED_SEED,
    draw,
    fixed_file,
    fixed_goals,
    fixed_names,
)
from learn2assemble.tasks.task import GOAL_TASKS

EXAMPLE = Path(__file__).parents[1] / "examples" / "goals" / "over_the_water.json"
GOOD: dict[str, Any] = {
    "format": "learn2assemble-goals",
    "version": 1,
    "site": [0.4, 0.05, 0.3],
    "reach": [[0.025, 0.0, 0.1]],
    "obstacles": [[[0.05, -0.02, 0.0], [0.1, 0.02, 0.04]]],
}
"""Good goals; every bad one differs in one thing."""


def env_of(name: str) -> Any:
    import gymnasium

    return gymnasium.make(f"learn2assemble.envs:learn2assemble/{name}-v0")


BAD: list[tuple[dict[str, Any], str]] = [
    ({"reach": [[0.025, 0.0, math.nan]]}, "finite"),
    ({"name": "a\x07b"}, "printable"),
    ({"reach": [[0.025, 0.0, 0.12]]}, "such as 0.1 m"),
    ({"reach": [[0.025, 0.0, 0.0]]}, "such as 0.05 m"),
    ({"reach": [[0.3, 0.0, 0.1]]}, "got [0.3, 0.0, 0.1], expected a point inside the site"),
    ({"reach": [[0.025, 0.0, 5.0]]}, "inside the site"),
    ({"reach": [[0.075, 0.0, 0.05]]}, "outside the obstacles"),
    ({"occupy": [{"at": [0.075, 0.0, 0.01]}]}, "outside the obstacles"),
    ({"occupy": [{"at": [0.025, 0.0, 0.2]}]}, "above no surface"),
    ({"occupy": [{}]}, "either 'at' or 'box'"),
    ({"occupy": [{"box": [[0, 0, 0.1], [0, 0, 0.1]]}]}, "lowest corner"),
    ({"occupy": [{"box": [[0, -0.02, 0.1], [9, 0.02, 0.2]]}]}, "inside the site"),
    ({"occupy": [{"at": [0.025, 0.0]}]}, "a list of 3 values"),
    ({"reach": []}, "a goal"),
    ({"load": [{"at": [0.025, 0.0, 0.1]}]}, "either 'mass' or 'force'"),
    ({"load": [{"at": [0.025, 0.0, 0.1], "mass": -1}]}, "1e-06"),
    ({"load": [{"at": [0.0, 0.0, 0.1], "mass": 1}] * 6}, "at most 5"),
    ({"obstacles": [[[0, 0, 0], [0, 0]]]}, "a list of 3 values"),
    ({"obstacles": [[[-1, -1, 0.2], [1, 1, 0.3]]]}, "no obstacle above"),
    ({"heap": {"1x44": 3}}, "did you mean"),
    ({"heap": {"1x4": -3}}, "0 to"),
    ({"heap": {"1x4": 0}}, "at least one block"),
    ({"heap": [3]}, "object"),
    ({"site": [40.0, 0.05, 0.3]}, "1 to 64 cells"),
    ({"site": [0.4, 0.01, 0.3]}, "1 to 64 cells"),
    ({"cell": [0.05, 0.05, -1.0]}, "lengths from"),
    ({"kit": "brickz"}, "did you mean"),
    ({"goal": []}, "key"),
    ({"props": 1}, "true or false"),
    ({"version": 2}, "expected 1"),
    ({"units": "mm"}, "metres"),
]


def goals_of(**changes: Any) -> Goals:
    return parse_goals(GOOD | changes)


def meets(goals: dict[str, Any], plan: Plan) -> None:
    """Check a plan against the file in metres, by the polyhedra that stand in the end."""
    assert plan.complete
    assert plan.assembly is not None
    standing = {s.block for s in plan.steps} - {s.block for s in plan.steps if s.action == "remove"}
    boxes = [
        (plan.assembly.blocks[b].vertices.min(0), plan.assembly.blocks[b].vertices.max(0))
        for b in standing
    ]

    def inside(point: Any) -> bool:
        return any(((low - 2e-4 <= point) & (point <= high + 2e-4)).all() for low, high in boxes)

    for entry in goals.get("occupy", []):
        corners = np.array(entry["box"] if "box" in entry else [entry["at"]] * 2, float)
        for share in np.random.default_rng(0).random((30, 3)):
            assert inside(corners[0] + share * (corners[1] - corners[0]))
    for x, y, z in [*goals.get("reach", []), *(load["at"] for load in goals.get("load", []))]:
        assert inside(np.array([x, y, z - 1e-3]))
        for low, high in boxes:
            over = (low[:2] < [x, y]).all() and ([x, y] < high[:2]).all()
            assert not (over and high[2] > z + 1e-3)
    for low, high in np.array(goals.get("obstacles", [])).reshape(-1, 2, 3):
        for a, b in boxes:
            assert not ((np.minimum(b, high) - np.maximum(a, low)) > 1e-6).all()
    counts = goals.get("heap")
    if counts is not None:
        kinds = [plan.assembly.blocks[s.block].kind for s in plan.steps if s.action == "place"]
        assert all(kinds.count(kind) <= counts.get(kind, 0) for kind in set(kinds))
    assert check(plan.assembly).verdict == "stands"


def draw_goals(family: str, seed: int, spatial: bool = False) -> Goals | None:
    """The goals of a family and a seed; None where they contradict one another."""
    try:
        return parse_goals(draw(family, seed, spatial), "task")
    except InputError:
        return None


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("spatial", [False, True])
def test_what_is_complete_meets_the_goals(family: str, spatial: bool) -> None:
    """The search has 500 looks at its clock, on any machine."""
    tried = 0
    for seed in range(50_000, 50_010):
        goals = draw_goals(family, seed, spatial)
        if goals is None or tried == 2:
            continue
        tried += 1
        timer = count(0.0, 0.002).__next__
        try:
            plan = plan_goals(goals, ways=(SEARCH,), seconds=1.0, seed=seed, timer=timer)
        except InputError:
            continue
        assert plan.status in ("complete", "incomplete", "refused")
        if plan.complete:
            meets(draw(family, seed, spatial), plan)
        else:
            assert plan.reason
    assert tried


def test_the_example_is_built_with_the_fewest_blocks() -> None:
    goals = read_goals(EXAMPLE)
    found = search(make_problem(goals), seconds=20)
    exact = plan_program(make_problem(goals), seconds=100)
    assert exact.status == "optimal"
    assert exact.bound == len(exact.placements) == found.blocks == 4
    for ways, stage in ((WAYS, "search"), ((EXACT,), "exact program")):
        plan = plan_goals(goals, ways=ways)
        assert plan.search is not None
        assert [tried.stage for tried in plan.search.attempts] == [stage]
        meets(json.loads(EXAMPLE.read_text()), plan)


@pytest.mark.parametrize(("family", "seed"), [("corbel", 0), ("table", 2), ("stairs", 3)])
def test_no_structure_has_fewer_blocks_than_the_bound(family: str, seed: int) -> None:
    goals = draw_goals(family, seed)
    assert goals is not None
    found = search(make_problem(goals), seconds=3)
    exact = plan_program(make_problem(goals), seconds=5)
    assert exact.status in ("optimal", "time", "feasible")
    assert 0 < exact.bound <= found.blocks


def test_loads_are_balanced_by_counterweights() -> None:
    """A lone beam would tip: what is called complete stands with the load as a block of its own."""
    file = GOOD | {
        "reach": [],
        "load": [{"at": [0.125, 0.0, 0.1], "mass": 0.6}],
        "obstacles": [[[0.05, -0.02, 0.0], [0.2, 0.02, 0.04]]],
    }
    plan = plan_goals(parse_goals(file), seconds=10)
    meets(file, plan)
    assert plan.blocks.used > 2
    assert plan.assembly is not None
    half, top = 0.02, 0.1
    low, high = (0.125 - half, -half, top), (0.125 + half, half, top + 2 * half)
    heavy = box_block("load", low, high, density=0.6 / (2 * half) ** 3)
    loaded = l2a.Assembly((*plan.assembly.blocks, heavy), (), plan.assembly.friction, "loaded")
    assert check(loaded).verdict == "stands"


@pytest.mark.parametrize("name", GOAL_TASKS)
def test_environments_pass_the_checker_and_are_solved_by_the_search(name: str) -> None:
    env = env_of(name).unwrapped
    check_env(env, skip_render_check=True)
    found = search(env.problem, seconds=20)
    observation, info = env.reset(seed=0)
    total, ended = 0.0, False
    for block in found.placements:
        assert not ended
        action = list(env._offered).index(env.problem.site.candidates([block])[0])
        assert observation["mask"][action]
        observation, reward, ended, _, info = env.step(action)
        assert info["stood"]
        total += reward
    assert ended
    assert info["success"]
    assert total == pytest.approx(2 - 0.05 * found.blocks)


def bare(file: dict[str, Any]) -> str:
    return json.dumps({**file, "name": ""})


def test_fixed_tasks_are_as_many_as_asked_and_none_is_tuned_on() -> None:
    names, developed = fixed_names(), fixed_names(development=True)
    assert len(set(names)) == len(names) == 55
    assert sum(name.startswith("planar/") for name in names) == 30
    assert sum(name.startswith("spatial/") for name in names) == 20
    assert all(int(n.split("/")[2]) >= FIRST_FIXED_SEED for n in names[:50])
    assert all(int(n.split("/")[2]) < FIRST_FIXED_SEED for n in developed)
    files = [bare(fixed_file(name)) for name in names + developed]
    assert len(set(files)) == len(files)


def test_no_fixed_task_was_left_out_because_it_is_hard() -> None:
    """From the first seed on every one is there, or impossible, or the same as another."""
    names, left_out = fixed_names()[:50], 0
    seen = {bare(fixed_file(name)) for name in fixed_names(development=True)}
    for kind, family in sorted({tuple(name.split("/")[:2]) for name in names}):
        mine = [int(n.split("/")[2]) for n in names if n.startswith(f"{kind}/{family}/")]
        for seed in range(FIRST_FIXED_SEED, max(mine) + 1):
            file = bare(draw(family, seed, kind == "spatial"))
            if seed not in mine:
                goals, left_out = draw_goals(family, seed, kind == "spatial"), left_out + 1
                assert goals is None or file in seen or prepare(goals)[1]
            seen.add(file)
    assert left_out == 9


def test_the_task_that_no_search_solved_can_be_solved() -> None:
    """A lintel on two columns: found by hand, with the same proof as any plan."""
    goals = fixed_goals("spatial/tower/20002")
    problem, _ = prepare(goals)
    structure = [((x, 1, z), 2) for x in (1, 7) for z in range(4)] + [((1, 1, 4), 8)]
    wanted = [{(x + k, y, z) for k in range(n)} for (x, y, z), n in structure]
    by_cells = {
        frozenset(map(tuple, placement_cells(problem.site.placement(k), goals.kit).tolist())): k
        for k in range(len(problem.site))
    }
    order = find_order(problem, [by_cells[frozenset(cells)] for cells in wanted])
    assert order is not None
    assert finished(problem, tuple(problem.site.placement(k) for k in order))


@pytest.mark.parametrize("name", [n for n in fixed_names() if n.startswith("impossible")])
def test_impossible_tasks_are_refused(name: str) -> None:
    if name == "impossible/heavy load":
        with pytest.raises(InputError, match="heap can balance"):
            plan_goals(fixed_goals(name), seconds=20)
        return
    plan = plan_goals(fixed_goals(name), seconds=20)
    assert plan.status == "refused"
    assert plan.reason


IMPOSSIBLE: dict[str, dict[str, Any]] = {
    "the heap is too low": {"heap": {"1x4": 1}},
    "the heap is too small": {
        "occupy": [{"box": [[-0.199, -0.02, 0.001], [0.049, 0.02, 0.049]]}],
        "heap": {"1x1": 4},
    },
    "the gap is too wide": {
        "reach": [[0.0, 0.0, 0.1]],
        "obstacles": [[[-0.15, -0.02, 0], [0.15, 0.02, 0.04]]],
        "heap": {"1x1": 20, "1x2": 20},
    },
    "its counterweight is missing": {
        "load": [{"at": [0.075, 0.0, 0.1], "mass": 0.3}],
        "reach": [],
        "obstacles": [[[0.0, -0.02, 0.0], [0.2, 0.02, 0.04]]],
        "heap": {"1x4": 1, "1x5": 1},
    },
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_what_is_impossible_is_refused_with_a_reason(name: str) -> None:
    goals = goals_of(**IMPOSSIBLE[name])
    assert plan_program(make_problem(goals), seconds=60).status == "infeasible"
    plan = plan_goals(goals, seconds=20)
    assert plan.status == "refused"
    assert plan.reason
    assert not plan.steps


def test_a_load_the_heap_cannot_balance_is_bad_input() -> None:
    with pytest.raises(InputError, match="heap can balance"):
        plan_goals(
            goals_of(
                reach=[],
                load=[{"at": [0.175, 0.0, 0.1], "mass": 900}],
                obstacles=[[[0.0, -0.02, 0.0], [0.2, 0.02, 0.04]]],
            )
        )


def test_props_are_taken_away_again_only_where_they_are_allowed() -> None:
    for props in (False, True):
        plan = plan_goals(goals_of(props=props, reach=[[-0.075, 0, 0.1], [0.025, 0, 0.1]]))
        assert plan.complete
        assert props or all(step.action == "place" for step in plan.steps)


@pytest.mark.parametrize(("changes", "words"), BAD)
def test_bad_goals_end_in_one_line(
    changes: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "goals.json"
    file.write_text(json.dumps(GOOD | changes))
    assert main(["build", str(file), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said
    assert "\n" not in said
    assert not (tmp_path / "out").exists()


def test_options_of_drawings_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "goals.json"
    file.write_text(json.dumps(GOOD))
    assert main(["build", str(file), "--unit", "mm", "--out", str(tmp_path / "out")]) == 2
    assert "goals are read with cell alone" in capsys.readouterr().err


def test_a_plan_shows_its_goals(tmp_path: Path) -> None:
    goals = read_goals("examples/goals/over_the_water.json")
    plan = l2a.build(goals, seconds=20)
    found = {box.what: (box.low, box.high) for box in plan.design.boxes}
    assert found["reach"] == ((0.0, -0.025, 0.15), (0.05, 0.025, 0.15))
    assert found["load"] == ((0.1, -0.025, 0.2), (0.15, 0.025, 0.2))
    assert found["obstacle"] == ((0.003, -0.02, 0.0), (0.297, 0.02, 0.047))
    again = l2a.Plan.load(plan.save(tmp_path, video=False)["plan"])
    assert again.design.boxes == plan.design.boxes
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert '"what":"load"' in page
    assert "obstacle</li>" in page


@pytest.mark.parametrize(
    ("changes", "status", "reason"),
    [
        ({"heap": {"1x1": 1}}, "refused", "levels high"),
        ({"heap": {"1x2": 2}, "reach": [[0.125, 0.0, 0.15]]}, "refused", "levels high"),
    ],
)
def test_refused_goals_end_in_exit_code_1_and_a_page_that_opens(
    tmp_path: Path, changes: dict[str, Any], status: str, reason: str
):
    file = tmp_path / "goals.json"
    file.write_text(json.dumps(GOOD | changes))
    out = tmp_path / "out"
    assert main(["build", str(file), "--out", str(out)]) == 1
    plan = Plan.load(out)
    assert plan.status == status
    assert plan.found_nothing
    assert reason in (plan.reason or "")
    page = (out / "view.html").read_text()
    assert reason in page
    assert "{{" not in page


def test_goals_for_which_nothing_is_found_end_in_exit_code_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    planner = "learn2assemble.planning.goals.planner"
    monkeypatch.setattr(f"{planner}.search", lambda problem, **given: Found((), 1, 0.0))
    monkeypatch.setattr(
        f"{planner}.plan_program", lambda problem, **given: ProgramResult("time", (), 1, 0)
    )
    monkeypatch.setattr(f"{planner}.find_stacks", lambda problem, **given: ())
    file = tmp_path / "goals.json"
    file.write_text(json.dumps(GOOD))
    assert main(["build", str(file), "--out", str(tmp_path / "out")]) == 1
    plan = Plan.load(tmp_path / "out")
    assert plan.status == "incomplete"
    assert plan.reason
    assert "What was tried" in (tmp_path / "out" / "view.html").read_text()


def two_towers(**given) -> dict:
    """Two points at the height of ten levels, and twenty blocks, each of which is needed."""
    return {
        "format": "learn2assemble-goals",
        "version": 1,
        "kit": "bricks-lintels",
        "site": [0.7, 0.3, 0.5],
        "reach": [[-0.225, 0.025, 0.5], [0.225, 0.025, 0.5]],
        "heap": {"2x2": 8, "1x1": 4, "1x4": 4, "1x2": 4},
        **given,
    }


@pytest.mark.parametrize("ways", [WAYS, (SEARCH,)])
def test_a_heap_that_just_suffices_is_shared_out_between_two_stacks(ways: tuple[str, ...]) -> None:
    plan = plan_goals(parse_goals(two_towers()), ways=ways, seconds=600)
    assert plan.complete, plan.reason
    assert (plan.blocks.used, plan.search.needed) == (20, "stacks")
    fewer = {"2x2": 8, "1x1": 4, "1x4": 4, "1x2": 3}
    assert not find_stacks(make_problem(parse_goals(two_towers(heap=fewer))))


def test_the_blocks_of_two_stacks_fill_their_drawing() -> None:
    """The same two towers, drawn as cells, with the same heap."""
    goals = parse_goals(two_towers())
    blocks = find_stacks(make_problem(goals))
    wanted = np.zeros(goals.shape, bool)
    for block in blocks:
        wanted[tuple(placement_cells(block, goals.kit).T)] = True
    tiling, ordering = plan_exact(wanted, goals.kit, seconds=600)
    assert ordering is not None
    assert ordering.status == "complete"
    assert len(tiling.placements) == 20
