"""Tables: published numbers, specification, cells, result files, numbers and words."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from l2a_lab import numbers as published_module
from l2a_lab import packed
from l2a_lab.bounds import best_return, return_bound
from l2a_lab.cell_jobs import CellJob, jobs, row_cells, run_jobs, share_size, stale
from l2a_lab.cells import (
    BOUND,
    Cell,
    agent_hash,
    farther_view,
    find_agents,
    is_current,
    measure,
    measured_agents,
    mended_policy,
    read_result,
    write_result,
)
from l2a_lab.numbers import (
    NOT_AVAILABLE,
    NOT_MEASURED,
    NOT_TRAINED,
    Published,
    Summary,
    TableData,
    TableEntry,
    load_table,
    published,
    student,
)
from l2a_lab.recipes import RECIPES
from l2a_lab.report import (
    BETTER,
    FIGURES,
    LEVEL,
    QUICK,
    WORSE,
    against_paper,
    failures_beside,
    lines,
    markdown,
    return_beside,
    sections,
)
from l2a_lab.table import LOOK_AHEAD, RANDOM, UNTRAINED, Column, Condition, Row, Table
from l2a_lab.tables import BUILDER, SHIPPED, TABLES, get_table
from l2a_lab.tables_page import figures_of, page_of, read_tables
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.evaluation.episodes import (
    episode_generators,
    lookahead_policy,
    make_policy,
    play_episodes,
    random_policy,
    run_episodes,
)
from learn2assemble.tasks.networks.agent import Agent, load_agent, save_agent
from learn2assemble.tasks.networks.agent_file import described, read_description
from learn2assemble.tasks.networks.config import NetworkConfig
from learn2assemble.tasks.networks.placement import PlacementNetwork
from learn2assemble.tasks.networks.qnetwork import QNetwork
from learn2assemble.tasks.search.config import SEARCHES, TO_THE_END, SearchConfig
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.task import get_task
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import lookahead_actions

torch.set_num_threads(1)

ROOT = Path(__file__).parents[2]
NAME = "one-sided-3x3-22-24"
TASK = get_task(NAME)
PAPER_CELL = Published(R=3.0, R_ci95=0.1, a=8.0, b=None, f=0.2)
SMALL = Table(
    "small",
    "A table for the tests",
    (Column(NAME, True, {"grid": "3x3", "blocks": "20-24"}),),
    (
        Row("plain", "tiny", paper={"method": "DQN", "search_budget": "0"}),
        Row("searched", "tiny", "dqn-mcts", 3, paper={"method": "DQN+MCTS"}),
        Row("absent", "nobody"),
        Row("look-ahead", policy=LOOK_AHEAD, help="knows outcomes", kind="reference"),
        Row("played elsewhere", policy=RANDOM, columns=(1,)),
    ),
    {"source_table": "main_T2"},
)


def save_tiny(folder: Path, name: str, seed: int) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed)
    config = NetworkConfig(width=16, heads=2, rounds=1, position_scale=0.1)
    return save_agent(Agent(name, QNetwork(config), NAME, {}), folder)


@pytest.fixture
def agents(tmp_path: Path) -> Path:
    """Two agents that have learned nothing."""
    for seed in (0, 1):
        save_tiny(tmp_path / "agents", f"tiny-s{seed}", seed)
    return tmp_path / "agents"


# Specification and published numbers.


def test_every_published_number_has_its_place() -> None:
    """All lines of the tables we reproduce are shown, each once, and nothing else."""
    with published_module.FILE.open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    for name, table in TABLES.items():
        if not table.paper or name == "shipped":
            continue
        once = [c for c in table.columns if not c.task.endswith("-trained-shapes")]
        found = [published(table, row, c) for row in table.rows for c in once]
        shown = sorted((p.R, p.f) for p in found if p is not None)
        wanted = [
            (float(line["R"]), float(line["f"]))
            for line in lines
            if all(line[key] == value for key, value in table.paper.items())
        ]
        assert shown == sorted(wanted), name
        assert wanted


def test_a_published_number_by_hand() -> None:
    table = get_table("a4")
    row = next(r for r in table.rows if r.label.startswith("ε-MCTS, budget 5, to the end"))
    assert published(table, row, table.columns[4]) == Published(3.58, 0.12, 13.28, None, 0.92)
    assert row.search_config(0.05) == SearchConfig(
        budget=5, rollout=TO_THE_END, expansion="uct", random_first=True
    )
    table = get_table("A3")
    assert published(table, table.rows[1], table.columns[3]) == Published(
        2.40, 0.10, None, None, 0.26
    )


def test_two_published_lines_for_one_cell_are_a_mistake() -> None:
    with pytest.raises(LookupError, match="fit"):
        published(SMALL, SMALL.rows[0], Column("x", paper={"robot": "no"}))
    assert published(dataclasses.replace(SMALL, paper={}), SMALL.rows[0], SMALL.columns[0]) is None


@pytest.mark.parametrize("table", TABLES.values(), ids=str)
def test_tables_name_what_exists(table: Table) -> None:
    for name in set(table.stems) - {BUILDER}:
        for stage in RECIPES[name].stages:
            stage.resolve(RECIPES[name].task)
    assert all(row.pick([f"{name}-s0"]) for row in table.rows for name in [row.agents] if name)
    assert all(column.preset.name == column.name for column in table.columns)
    assert all(row.search in SEARCHES for row in table.rows if row.search)
    assert any(row.policy == LOOK_AHEAD for row in table.rows)


def test_no_two_cells_share_a_file() -> None:
    files: dict[str, Cell] = {}
    for table in TABLES.values():
        for row in table.rows:
            for number in range(len(table.columns)):
                for cell in row_cells(table, row, number, [f"{row.agents}-s{k}" for k in (0, 1)]):
                    assert files.setdefault(cell.path, cell) == cell
    assert len(files) > 100


def test_agents_of_a_row() -> None:
    names = ["dqn-s10", "dqn-s2", "dqn", "dqn-mcts-s0", "xdqn-s0", "dqn-s", "q-mcts-s0"]
    assert Row("", "dqn").pick(names) == ["dqn", "dqn-s2", "dqn-s10"]
    assert Row("").pick(names) == []


def test_unknown_table_names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'shipped'"):
        get_table("shpped")


# Cells.


def test_a_cell_survives_json_and_new_settings() -> None:
    cell = Cell(TASK, "agent", "a-s1", SearchConfig(3, distinct=True), 0.05, "rigid", 1)
    values = json.loads(json.dumps(cell.to_dict()))
    assert Cell.from_dict(values) == cell
    assert cell.path == f"cells/{NAME}/a-s1.b3-distinct=True.eps0.05.rigid.json"
    # A file from before a setting existed means its default.
    del values["search"]["random_first"]
    assert Cell.from_dict(values) == cell
    with pytest.raises(InputError, match="bugdet"):
        Cell.from_dict({**values, "search": {"bugdet": 3}})


def test_measuring_is_playing_episodes(agents: Path) -> None:
    cell = Cell(TASK, "agent", "tiny-s1", SearchConfig(2, 0.1), 0.1, seed=1)
    data = measure(cell, str(agents / "tiny-s1.safetensors"), 7)
    network = load_agent(str(agents / "tiny-s1.safetensors")).network
    metrics = run_episodes(TASK, make_policy(TASK, network, cell.search, 0.1), 7, 1)
    assert np.mean(data["returns"]) == pytest.approx(metrics.R, abs=1e-6)
    assert np.mean(data["failed"]) == metrics.f
    assert np.mean(data["actions"]) == metrics.a
    assert "returns_at_0.8" not in data
    # Discounted more, a return of 0 and 1 and a last -1 differs as the sum says.
    for own, other, count in zip(
        data["returns"], data["returns_at_0.95"], data["actions"], strict=True
    ):
        assert abs(other) <= (1 - 0.95**count) / 0.05 + 1e-6
        assert (own == 0) == (other == 0) or count > 1


def test_agents_of_a_row_share_its_problems(agents: Path) -> None:
    """The first share is the beginning of all, the others go on behind it."""
    weights = {f"tiny-s{k}": agents / f"tiny-s{k % 2}.safetensors" for k in (0, 1, 3, 8)}
    row, by_name = SMALL.rows[0], {job.cell.path: job for job in jobs(SMALL, weights, 120)}
    cells = row_cells(SMALL, row, 0, row.pick(weights))
    assert [(cell.agent, cell.share) for cell in cells[:4]] == [
        ("tiny-s0", 0),
        ("tiny-s1", 1),
        ("tiny-s3", 3),
        ("tiny-s8", 3),
    ]
    assert {by_name[cell.path].episodes for cell in cells} == {40}
    assert share_size(1000, 3) == 350
    problems, simulator = episode_generators(2)[0], Simulator(TASK)
    state, seen = simulator.new(9, problems), []

    def watch(now: State, rng: np.random.Generator) -> np.ndarray:
        seen.append(now.vertices.copy())
        return np.zeros((now.batch_size, 3), np.int64)

    play_episodes(simulator, watch, 3, 2, first=6)
    np.testing.assert_array_equal(seen[0], state.vertices[6:])
    greedy = Cell(TASK, "agent", "tiny-s0", seed=2)
    whole, last = (
        measure(dataclasses.replace(greedy, share=n), str(weights["tiny-s0"]), size)["returns"]
        for n, size in ((0, 9), (2, 3))
    )
    assert whole[6:] == last
    own = [play_episodes(simulator, random_policy(5), 3, 2, first=n).returns for n in (3, 3, 0)]
    assert (own[0] == own[1]).all()
    assert (own[0] != own[2]).any()


def test_bound_and_look_ahead_meet_the_same_problems() -> None:
    bound = measure(Cell(TASK, BOUND, seed=3), None, 60)["returns"]
    reached = measure(Cell(TASK, LOOK_AHEAD, seed=3), None, 60)
    simulator = Simulator(TASK)
    state = simulator.new(60, episode_generators(3)[0])
    exact = [best_return(simulator, state, row) for row in range(60)]
    np.testing.assert_allclose(bound, exact, atol=1e-6)
    assert (np.array(bound) <= return_bound(state, TASK.discount) + 1e-6).all()
    assert (np.array(reached["returns"]) <= np.array(bound) + 1e-5).all()
    assert sum(reached["failed"]) == 0


def test_mended_policies_take_the_look_ahead_where_they_would_gain_nothing() -> None:
    simulator, look_ahead = Simulator(TASK), lookahead_policy(TASK, 0.0)
    expected = play_episodes(simulator, look_ahead, 12, 0)

    def mend(state: State, actions: np.ndarray) -> np.ndarray:
        return lookahead_actions(simulator, state)

    same = play_episodes(simulator, mended_policy(TASK, look_ahead, mend), 12, 0)
    np.testing.assert_array_equal(same.returns, expected.returns)
    chance = random_policy(TASK.num_actions)
    assert play_episodes(simulator, chance, 12, 0).failed.any()
    mended = play_episodes(simulator, mended_policy(TASK, chance, mend), 12, 0)
    assert not mended.failed.any()


def test_a_farther_view_replaces_placements_by_valid_ones_only() -> None:
    task = get_task("two-sided-8x8-90-94")
    agent, simulator = load_agent(SHIPPED), Simulator(task)
    assert isinstance(agent.network, PlacementNetwork)
    mend, rng = farther_view(task, agent.network), np.random.default_rng(0)
    state = simulator.new(24, rng)
    for _ in range(3):
        given = simulator.random_actions(state, rng)
        found = mend(state.copy(), given.copy())
        changed = (found != given).any(1)
        assert changed.any()
        step = simulator.step(state, found)
        assert (step.verdict[changed] == 0).all()
        state = state.take(np.flatnonzero(~step.terminated))


def test_untrained_policies_need_no_agent() -> None:
    data = measure(Cell(TASK, UNTRAINED, search=SearchConfig(2, 0.0)), None, 2)
    assert len(data["returns"]) == data["episodes"] == 2


# Result files.


def fake(root: Path, cell: Cell, returns: list[float], failed: list[int], **more: Any) -> None:
    """A result file with given numbers."""
    count = len(returns)
    data = {
        "commit": "abc",
        "episodes": count,
        "returns": returns,
        "actions": [4] * count,
        "failed": failed,
        "success": [1 - f for f in failed],
        "coverage": [0.5] * count,
        **more,
    }
    write_result(root, cell, "hash" if cell.agent else None, data)


def test_result_files_round_trip_and_staleness(tmp_path: Path) -> None:
    cell = Cell(TASK, "agent", "tiny-s0", SearchConfig(3, 0.05), 0.05)
    assert not is_current(tmp_path, cell, "hash", 1)
    fake(tmp_path, cell, [1.0, 2.0], [0, 1])
    result = read_result(tmp_path / cell.path)
    assert result is not None
    assert (result.cell, result.agent_hash, result.episodes) == (cell, "hash", 2)
    assert result.array("returns").tolist() == [1.0, 2.0]
    assert is_current(tmp_path, cell, "hash", 2)
    assert is_current(tmp_path, cell, "hash", 1)
    assert not is_current(tmp_path, cell, "hash", 3)
    assert not is_current(tmp_path, cell, "other", 2)
    for change in (
        {"task": TASK.replace(discount=0.9)},
        {"seed": 4},
        {"search": dataclasses.replace(cell.search or SearchConfig(), prior=False)},
    ):
        changed = dataclasses.replace(cell, **change)
        file = tmp_path / changed.path
        file.parent.mkdir(parents=True, exist_ok=True)
        if file != tmp_path / cell.path:
            file.write_bytes((tmp_path / cell.path).read_bytes())
        assert not is_current(tmp_path, changed, "hash", 2)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"format": "learn2assemble-cell", "version": 2}',
        '{"format": "learn2assemble-cell", "version": 1, "cell": {}, "agent_hash": null}',
    ],
)
def test_damaged_result_files_count_as_absent(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    assert read_result(tmp_path / "a.json") is None


def test_packed_results_are_the_same_and_newer_ones_take_their_place(tmp_path: Path) -> None:
    one, two = (Cell(TASK, "agent", f"tiny-s{k}", None, 0.05) for k in range(2))
    for cell in (one, two):
        fake(tmp_path, cell, [1.0, 2.0], [0, 1])
    before = {cell.path: read_result(tmp_path / cell.path) for cell in (one, two)}
    (tmp_path / one.path).with_name("damaged.json").write_text("{")
    assert packed.pack(tmp_path / "cells") == 2
    assert [file.name for file in (tmp_path / "cells" / NAME).iterdir()] == ["damaged.json"]
    pack = tmp_path / f"cells{packed.ENDING}"
    bytes_ = pack.read_bytes()
    for cell in (one, two):
        assert read_result(tmp_path / cell.path) == before[cell.path]
        assert is_current(tmp_path, cell, "hash", 2)
    assert packed.names(tmp_path / "cells") == [
        f"{NAME}/damaged.json",
        *sorted(cell.path.removeprefix("cells/") for cell in (one, two)),
    ]
    assert packed.names(tmp_path / "cells", "two-sided") == []
    assert measured_agents(tmp_path, NAME) == {"tiny-s0", "tiny-s1"}
    # The same results, whenever they are packed, are the same file.
    for cell in (one, two):
        fake(tmp_path, cell, [1.0, 2.0], [0, 1])
    packed.pack(tmp_path / "cells")
    assert pack.read_bytes() == bytes_
    fake(tmp_path, one, [3.0, 4.0], [0, 0])
    newer = read_result(tmp_path / one.path)
    assert newer is not None
    assert newer.array("returns").tolist() == [3.0, 4.0]
    packed.pack(tmp_path / "cells")
    assert read_result(tmp_path / one.path) == newer
    assert read_result(tmp_path / two.path) == before[two.path]


def test_result_with_too_few_numbers_counts_as_absent(tmp_path: Path) -> None:
    cell = Cell(TASK, LOOK_AHEAD)
    fake(tmp_path, cell, [1.0, 2.0], [0, 1], coverage=[0.5])
    assert read_result(tmp_path / cell.path) is None


def test_hash_of_an_agent_sees_weights_and_architecture(tmp_path: Path) -> None:
    a, b = save_tiny(tmp_path, "a", 0), save_tiny(tmp_path, "b", 1)
    assert agent_hash(a) == agent_hash(a) != agent_hash(b)
    before = agent_hash(a)
    info = read_description(a)
    save_file(load_file(a), a, described({**info, "origin": {"other": 1}}))
    assert agent_hash(a) == before
    save_file(load_file(a), a, described({**info, "network": {**info["network"], "heads": 1}}))
    assert agent_hash(a) != before


def test_agents_are_found_as_files_and_as_runs(tmp_path: Path) -> None:
    save_tiny(tmp_path, "tiny-s0", 0)
    save_tiny(tmp_path / "tiny-s1", "agent", 1)
    assert set(find_agents(tmp_path)) == {"tiny-s0", "tiny-s1"}
    damaged = tmp_path / "half-s0.safetensors"
    damaged.write_bytes(b"")
    with pytest.raises(InputError, match="half-s0"):
        agent_hash(find_agents(tmp_path)["half-s0"])
    assert "relational-cubes-s0" in find_agents(None)
    with pytest.raises(InputError, match="no such file"):
        find_agents(tmp_path / "nosuch")


# Measuring a table.


def test_only_missing_and_stale_cells_are_measured(agents: Path, tmp_path: Path) -> None:
    """An interruption loses nothing that is done; another agent brings only its own cells back."""
    root = tmp_path / "out"
    wanted = jobs(SMALL, find_agents(agents), 2)
    # Two agents, two rows, two conditions; the look-ahead; the bound.
    assert len(wanted) == 8 + 2 + 1
    assert {j.cell.seed for j in wanted} == {0}  # the same problems for all
    seen: list[CellJob] = []

    def stop_after_five(job: CellJob) -> None:
        seen.append(job)
        if len(seen) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs(root, stale(root, wanted), 1, stop_after_five)
    left = stale(root, wanted)
    assert {j.cell.path for j in left} == {j.cell.path for j in wanted} - {
        j.cell.path for j in seen
    }
    run_jobs(root, left, 1)
    assert stale(root, wanted) == []
    save_tiny(agents, "tiny-s1", 7)
    again = stale(root, jobs(SMALL, find_agents(agents), 2))
    assert {j.cell.agent for j in again} == {"tiny-s1"}
    assert len(again) == 4
    assert len(stale(root, jobs(SMALL, find_agents(agents), 3))) == 11
    assert list(root.rglob("*.part")) == []


@pytest.mark.slow
def test_workers_measure_the_same(agents: Path, tmp_path: Path) -> None:
    # One for each worker: of the row without a search and of that with one.
    found = [job for job in jobs(SMALL, find_agents(agents), 2) if job.cell.agent]
    by_search = {job.cell.search is None: job for job in found}
    wanted = list(by_search.values())
    assert len(wanted) == 2
    for folder, workers in (("one", 1), ("two", 2)):
        run_jobs(tmp_path / folder, wanted, workers)
    assert all(read_result(tmp_path / "one" / job.cell.path) for job in wanted)
    for job in wanted:
        one, two = ((tmp_path / name / job.cell.path).read_bytes() for name in ("one", "two"))
        assert one == two


def test_quick_takes_one_agent(agents: Path) -> None:
    wanted = jobs(SMALL, find_agents(agents), 2, max_agents=1)
    assert {j.cell.agent for j in wanted} == {"", "tiny-s0"}


# Numbers.


def filled(root: Path) -> None:
    """Results of two agents with known numbers."""
    for condition, shift in ((Condition(0.05), -1.0), (Condition(0.0), 0.0)):
        for seed, base in ((0, 3.0), (1, 3.5)):
            cell = Cell(TASK, "agent", f"tiny-s{seed}", None, condition.epsilon, share=seed)
            # Of the first agent more episodes than its share.
            more = [7.0] * (1 - seed)
            returns = [base + shift - 0.5, base + shift + 0.5, *more]
            fake(root, cell, returns, [0, seed, *[1 for _ in more]])
    fake(root, Cell(TASK, BOUND), [4.0, 4.0, 4.0, 7.0, 9.0], [0] * 5)


def test_numbers_of_a_row_by_hand(tmp_path: Path) -> None:
    filled(tmp_path)
    data = load_table(SMALL, tmp_path)
    entry = data.entries[0][0]
    clean, noisy = entry.results[Condition(0.0)], entry.results[Condition(0.05)]
    returns = [clean.R, noisy.R]
    assert returns == pytest.approx([3.25, 2.25])
    # Student's t for two agents, 1 and 2 below their bounds: 12.706 * (1 / sqrt 2) / sqrt 2.
    assert clean.R_ci95 == pytest.approx(12.706 * 0.5)
    # Over the four problems, 2.5, 3.5, 3 and 4: 1.96 * sqrt(1.25 / 3) / 2.
    assert clean.R_ci95_problems == pytest.approx(0.98 * math.sqrt(1.25 / 3))
    assert clean.over_agents
    assert (clean.agents, clean.episodes, clean.problems, clean.a) == (2, 4, 4, 4.0)
    assert (clean.f, clean.success, clean.b) == (0.25, 0.75, 0.0)
    assert clean.share == pytest.approx(3.25 / 4.75)
    assert noisy.share is None
    assert entry.paper == Published(3.21, 0.05, 7.93, None, 0.16)
    assert [e[0].state for e in data.entries] == [
        "",
        NOT_MEASURED,
        NOT_TRAINED,
        NOT_MEASURED,
        NOT_AVAILABLE,
    ]
    assert data.problems == (4, 4)


def test_differences_are_taken_problem_by_problem(tmp_path: Path) -> None:
    """Methods that differ by nearly as much on every problem are told apart, however much the
    problems differ."""
    rows = (Row("plain", "tiny"), Row("ours", "tiny", "dqn-mcts", 10, kind="own"))
    table = dataclasses.replace(SMALL, rows=rows)
    search = rows[1].search_config(0.0)
    fake(tmp_path, Cell(TASK, "agent", "tiny-s0", None, 0.0), [1.0, 5.0, 9.0], [0] * 3)
    fake(tmp_path, Cell(TASK, "agent", "tiny-s0", search, 0.0), [2.1, 6.0, 9.9, 4.0], [0] * 4)
    first, second = (row[0].results[Condition(0.0)] for row in load_table(table, tmp_path).entries)
    assert second.difference is None
    assert first.difference is not None
    assert first.difference == pytest.approx((-1.0, 1.96 * 0.1 / math.sqrt(3)))
    assert first.R_ci95 > 20 * first.difference[1]
    assert "| -1.00 ± 0.11 |" in markdown(load_table(table, tmp_path))


def test_intervals_over_agents_are_those_of_student() -> None:
    """Against a printed table; from ten agents on, too."""
    printed = {2: 12.706, 5: 2.776, 9: 2.306, 10: 2.262, 20: 2.093, 31: 2.042}
    assert {count: student(count) for count in printed} == printed


def test_interval_of_one_agent_is_over_episodes(tmp_path: Path) -> None:
    cell = Cell(TASK, "agent", "tiny-s0", None, 0.0)
    fake(tmp_path, cell, [1.0, 2.0, 3.0, 6.0], [0] * 4)
    summary = load_table(SMALL, tmp_path).entries[0][0].results[Condition(0.0)]
    spread = math.sqrt((4 + 1 + 0 + 9) / 3)
    assert summary.R_ci95 == pytest.approx(1.96 * spread / 2)
    assert not summary.over_agents
    # Without the bound of its problems there is no share.
    assert summary.share is None
    fake(tmp_path, Cell(TASK, BOUND), [4.0] * 3, [0] * 3)
    assert load_table(SMALL, tmp_path).entries[0][0].results[Condition(0.0)].share is None


def test_results_of_another_task_do_not_count(tmp_path: Path) -> None:
    cell = Cell(TASK.replace(discount=0.9), "agent", "tiny-s0", None, 0.0)
    fake(tmp_path, cell, [1.0, 2.0], [0, 0])
    assert load_table(SMALL, tmp_path).entries[0][0].results == {}


def summary(R: float, f: float, episodes: int = 100) -> Summary:
    return Summary(R, 0.1, 0.1, 8.0, 0.0, f, 1 - f, 1, episodes, episodes, None, None)


def test_marks() -> None:
    """Better by more than both intervals, worse than the paper's alone."""
    returns = {2.89: WORSE, 2.91: LEVEL, 3.19: LEVEL, 3.21: BETTER}
    assert {R: return_beside(PAPER_CELL, summary(R, 0)) for R in returns} == returns
    assert return_beside(None, summary(0, 0)) == failures_beside(None, summary(0, 0)) == ""
    # 1.96 * sqrt(0.2 * 0.8 / 500 + 0.3 * 0.7 / 100) = 0.0964; 0.3 at 1000 episodes: 0.0452.
    failures = {(0.29, 100): LEVEL, (0.3, 100): WORSE, (0.24, 1000): LEVEL, (0.25, 1000): WORSE}
    failures |= {(0.13, 100): LEVEL, (0.12, 100): BETTER, (0.15, 1000): BETTER}
    found = {(f, n): failures_beside(PAPER_CELL, summary(3, f, n)) for f, n in failures}
    assert found == failures


def test_ours_stands_against_the_published_rows_with_or_without_a_search() -> None:
    table = get_table("T4")
    column, condition = table.columns[0], table.conditions[0]
    numbers = [
        ("DQN, paper's schedule", None),
        ("DQN+MCTS, budget 10, paper's schedule", None),
        ("DQN, our schedule", None),
        ("DQN+MCTS, budget 10, our schedule", None),
        ("ours, no search", summary(3.3, 0.12)),
        ("ours, budget 10", summary(3.3, 0.3)),
        ("exact look-ahead", summary(3.0, 0.13)),
        # With other help, these do not stand against what was published.
        ("ours, no search", summary(9.0, 0.1)),
        ("ours, budget 10", summary(9.0, 0.1)),
    ]
    entries = tuple(
        (
            TableEntry(
                row,
                column,
                PAPER_CELL if row.paper and number is None else None,
                "",
                {condition: number} if number else {},
            ),
        )
        for row, (_, number) in zip(table.rows, numbers, strict=True)
    )
    assert [row.label for row in table.rows] == [label for label, _ in numbers]
    (sentence,) = against_paper(TableData(table, entries, (1, 1), False, ()), condition)
    # 3.3 - 0.1 > 3 + 0.1; 0.12 < 0.2 - 1.96 * sqrt(0.2 * 0.8 / 500 + 0.12 * 0.88 / 100), not 0.3.
    task = "robot-two-sided-3x3-10-14"
    assert "Ours against 2 published numbers at ε = 0.05, published" in sentence
    assert sentence.endswith(
        f"both intervals in 2, f below by more than the sampling error of both in 1, both in 1. "
        f"Not so: DQN+MCTS, budget 10, paper's schedule on {task} (f)."
    )
    assert against_paper(TableData(table, entries[:2], (1, 1), False, ()), condition) == []


# Words.


def test_text_depends_on_the_numbers_alone(tmp_path: Path) -> None:
    """Other commits, hardware, seconds and order of writing: the same bytes."""
    filled(tmp_path / "a")
    files = sorted((tmp_path / "a").rglob("*.json"), reverse=True)
    for file in files:
        other = tmp_path / "b" / file.relative_to(tmp_path / "a")
        other.parent.mkdir(parents=True, exist_ok=True)
        data = {**json.loads(file.read_text()), "commit": "zzz", "seconds": 99}
        other.write_text(json.dumps(data))
    a, b = (load_table(SMALL, tmp_path / name) for name in "ab")
    assert markdown(a) == markdown(b)
    assert lines(a) == lines(b)
    page = markdown(a)
    assert "| plain | 2 | 3.21 ± 0.05 | 2.25 ± 6.35 (0.63) 🔴 | 0.16 | 0.25 🟡 | 0.75 |" in page
    assert "| absent | not trained |" in page
    assert "| look-ahead (knows outcomes) | not measured |" in page
    assert "68.4 %" in page
    assert "over agents" in page
    assert QUICK not in page
    assert QUICK in markdown(load_table(SMALL, tmp_path / "a", quick=True))
    assert all(len(section.columns) <= 8 for section in sections(a))
    for section in sections(a):
        assert {len(row) for row in section.rows} == {len(section.columns)}


def test_all_figures_are_lines(tmp_path: Path) -> None:
    """Each number by the name of its column, the published ones where they compare only."""
    filled(tmp_path)
    data = load_table(SMALL, tmp_path)
    found = [dict(zip(FIGURES, line, strict=True)) for line in lines(data)]
    assert len(found) == 4 * 2, "the rows of this column, at two conditions"
    noisy, clean = (line for line in found if line["method"] == "plain")
    assert (noisy["epsilon"], noisy["R"], noisy["paper_R"], noisy["of_bound"]) == (
        *("0.05", "2.25", "3.21"),
        "",
    )
    assert (clean["epsilon"], clean["R"], clean["paper_R"]) == ("0", "3.25", "")
    assert float(clean["of_bound"]) == pytest.approx(3.25 / 4.75, rel=1e-5)
    assert {line["state"] for line in found if line["method"] == "absent"} == {"not trained"}


def test_marks_of_single_agents(tmp_path: Path) -> None:
    fake(tmp_path, Cell(TASK, "agent", "tiny-s0", None, 0.05), [3.0, 3.2] * 20, [0, 1] * 20)
    page = markdown(load_table(SMALL, tmp_path))
    assert "3.10 ± 0.03° 🔴" in page
    assert "0.50 🔴" in page


# The committed tables.


@pytest.mark.parametrize("name", TABLES)
def test_committed_tables_are_generated(name: str) -> None:
    chapters, rows = read_tables(ROOT / "results")
    data = load_table(get_table(name), ROOT / "results")
    assert chapters[name].strip() == markdown(data).strip()
    assert rows[name] == lines(data)


def test_committed_pages_hold_nothing_else() -> None:
    chapters, rows = read_tables(ROOT / "results")
    assert (ROOT / "results" / "tables.md").read_text(encoding="utf-8") == page_of(chapters)
    assert (ROOT / "results" / "tables.csv").read_text(encoding="utf-8") == figures_of(rows)


def committed_cells() -> list[Path]:
    """Every result by the path of its file."""
    cells = ROOT / "results" / "cells"
    return [cells / name for name in packed.names(cells)]


def test_committed_results_say_how_they_were_made() -> None:
    files = committed_cells()
    assert len(files) > 1000
    for file in files:
        result = read_result(file)
        assert result is not None, file
        assert file == ROOT / "results" / result.cell.path
        for key in ("commit", "hardware", "torch", "episodes"):
            assert result.data[key] is not None, (file, key)
        if result.cell.policy != BOUND:
            ended = result.array("failed") + result.array("success")
            assert set(ended) <= {0.0, 1.0}


def test_committed_results_of_shipped_agents_are_of_these_agents() -> None:
    shipped, hashed = find_agents(None), cache(agent_hash)
    for file in committed_cells():
        result = read_result(file)
        assert result is not None
        if result.cell.agent in shipped:
            assert result.agent_hash == hashed(shipped[result.cell.agent]), file
