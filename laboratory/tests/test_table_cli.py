"""``l2a-lab table`` and ``l2a-lab curves``, the trainings behind tables, and learning curves."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from l2a_lab import curves as curves_module
from l2a_lab.__main__ import command_line
from l2a_lab.curves import (
    FIGURES,
    decision_time,
    load_curves,
    load_scaled,
    read_log,
    time_to,
    timed_names,
)
from l2a_lab.recipes import (
    RECIPES,
    Recipe,
    RecipeStage,
    keep_logs,
    stage_folder,
    train_recipes,
)
from l2a_lab.report import QUICK
from l2a_lab.runs import keep_runs, read_runs, runs_in
from l2a_lab.tables import TABLES
from l2a_lab.tables_page import read_tables
from learn2assemble.cli import main
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.networks.agent import agent_files, load_agent
from learn2assemble.tasks.networks.agent_file import bare_weights
from learn2assemble.tasks.task import PRESETS
from test_tables import NAME, SMALL, save_tiny

torch.set_num_threads(1)

ROOT = Path(__file__).parents[2]
TINY_CHANGES = (
    "network.width=16",
    "network.rounds=1",
    "num_samples=64",
    "num_envs=4",
    "replay_size=50",
    "batch_size=4",
    "initial_samples=8",
)
TINY = Recipe("tiny", NAME, (RecipeStage("published", TINY_CHANGES),), seeds=2)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table ``small`` and the recipe of its agents."""
    monkeypatch.setitem(TABLES, "small", SMALL)
    monkeypatch.setitem(RECIPES, "tiny", TINY)


def l2a(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[dict[str, Any], str]:
    """The JSON result and standard error of a call that succeeds."""
    capsys.readouterr()
    assert main([*map(str, words), "--json"], command_line()) == 0
    captured = capsys.readouterr()
    return json.loads(captured.out), captured.err


@pytest.fixture
def agents(tmp_path: Path) -> Path:
    for seed in (0, 1):
        save_tiny(tmp_path / "agents", f"tiny-s{seed}", seed)
    return tmp_path / "agents"


@pytest.mark.usefixtures("small")
def test_a_table_is_measured_once(
    agents: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Measured, printed, written; a second call measures nothing and writes the same page."""
    words = [
        "table",
        "small",
        "--agents",
        agents,
        "--out",
        tmp_path / "out",
        "--episodes",
        2,
        "--workers",
        1,
    ]
    first, text = l2a(capsys, *words)
    assert first["measured"] == 11
    assert " 11 to measure: " in text
    assert "minutes with 1 processes; --quick measures less" in text
    assert not first["quick"]
    assert QUICK not in text
    # Words of a column that is narrow are broken; states are told below.
    for word in (NAME, "paper"):
        assert word in text
    states = {(row["task"], row["method"]): row["state"] for row in first["rows"]}
    assert states[NAME, "plain"] == "measured"
    assert states[NAME, "absent"] == "not trained"
    assert states[NAME, "played elsewhere"] == "not available"
    page = Path(first["files"]["markdown"])
    assert page == tmp_path / "out" / "tables.md"
    assert "| absent | not trained |" in page.read_text(encoding="utf-8")
    before = page.read_bytes()
    second, _ = l2a(capsys, *words)
    assert second["measured"] == 0
    assert page.read_bytes() == before
    assert second["rows"] == first["rows"]
    third, _ = l2a(capsys, "table", "small", "--from-files", "--out", tmp_path / "out")
    assert third["rows"] == first["rows"]
    assert page.read_bytes() == before


@pytest.mark.usefixtures("small")
def test_a_quick_look_says_so_and_stays_apart(
    agents: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    result, text = l2a(
        capsys, "table", "small", "--agents", agents, "--out", out, "--quick", "--workers", 1
    )
    assert result["quick"]
    assert QUICK in text
    assert QUICK in Path(result["files"]["markdown"]).read_text()
    assert [path.name for path in out.iterdir()] == ["quick"]
    (ours,) = {(cell["agents"], cell["episodes"]) for row in result["rows"] for cell in row["ours"]}
    assert ours == (1, 50)


@pytest.mark.usefixtures("small")
def test_a_table_replaces_its_own_part_of_the_files(
    agents: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["table", "small", "--agents", agents, "--out", out, "--episodes", 1, "--workers", 1]
    l2a(capsys, *words)
    before = [(out / name).read_text() for name in ("tables.md", "tables.csv")]
    result, _ = l2a(capsys, "table", "T1", "--from-files", "--out", out)
    page, figures = (Path(result["files"][kind]) for kind in ("markdown", "csv"))
    assert (page, figures) == (out / "tables.md", out / "tables.csv")
    chapters, rows = read_tables(out)
    assert list(chapters) == list(rows) == ["T1", "small"], "in the order of all tables"
    assert before[0].partition("<!-- table small -->")[2] in page.read_text()
    assert before[1].partition("\n")[2] in figures.read_text()
    after = page.read_bytes(), figures.read_bytes()
    l2a(capsys, *words)
    assert (page.read_bytes(), figures.read_bytes()) == after


@pytest.mark.usefixtures("small")
def test_training_the_agents_of_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``--train`` trains, measures and keeps the logs; again, it only looks."""
    words = [
        "table",
        "small",
        "--train",
        "--runs",
        tmp_path / "runs",
        "--out",
        tmp_path / "out",
        "--episodes",
        1,
        "--workers",
        1,
    ]
    first, _ = l2a(capsys, *words)
    assert {row["state"] for row in first["rows"] if row["method"] == "plain"} == {"measured"}
    assert first["rows"][0]["ours"][0]["agents"] == 2
    weights = bare_weights(tmp_path / "runs" / "tiny-s1" / "agent.safetensors")
    assert set(read_runs(tmp_path / "out" / "runs.jsonl.gz")) == {"tiny-s0", "tiny-s1"}
    second, _ = l2a(capsys, *words)
    assert second["measured"] == 0
    assert bare_weights(tmp_path / "runs" / "tiny-s1" / "agent.safetensors") == weights


# Recipes.


def test_every_recipe_resolves() -> None:
    for recipe in RECIPES.values():
        for stage in recipe.stages:
            config = stage.resolve(recipe.task)
            if recipe.task in PRESETS:
                assert config.network.num_actions == PRESETS[recipe.task].num_actions
    stage = RECIPES["s2v-full"].stages[0]
    assert stage.resolve("two-sided-3x3-20-24").network.encoder == "s2v"


def test_a_later_stage_starts_from_the_earlier(tmp_path: Path) -> None:
    slow = RecipeStage(
        "published", (*TINY_CHANGES, "learning_rate=1e-9", "final_learning_rate=1e-9")
    )
    recipe = Recipe("two", NAME, (RecipeStage("published", TINY_CHANGES), slow), seeds=1)
    told: list[str] = []
    train_recipes([recipe], tmp_path, seeds=1, progress=told.append)
    first, last = (load_agent(str(stage_folder(recipe, 0, tmp_path, n))) for n in (0, 1))
    assert stage_folder(recipe, 0, tmp_path, 1) == tmp_path / "two-s0"
    for a, b in zip(first.network.parameters(), last.network.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-5)
    assert "two-s0: R" in told[-1]
    keep_logs([recipe], tmp_path, tmp_path / "runs.jsonl.gz")
    assert list(read_runs(tmp_path / "runs.jsonl.gz")) == ["two-s0", "two-s0.stage1"]


def test_a_run_of_another_recipe_is_not_continued(tmp_path: Path) -> None:
    train_recipes([TINY], tmp_path, seeds=1)
    other = dataclasses.replace(
        TINY, stages=(RecipeStage("published", (*TINY_CHANGES, "batch_size=5")),)
    )
    with pytest.raises(InputError, match="a run of the recipe tiny"):
        train_recipes([other], tmp_path, seeds=1)
    (tmp_path / "tiny-s0" / "config.json").write_text("{")
    with pytest.raises(InputError, match="a run of the recipe tiny"):
        train_recipes([TINY], tmp_path, seeds=1)


def test_a_recipe_of_an_unknown_task_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="task"):
        train_recipes([TINY, dataclasses.replace(TINY, name="b", task="nosuch")], tmp_path)
    assert list(tmp_path.iterdir()) == []


# Curves.


def log(pack: Path, name: str, values: list[tuple[int, float]]) -> None:
    """Add a run to a pack."""
    lines: list[dict[str, float]] = [{"samples": 0, "epsilon": 1.0}]
    lines += [
        {"samples": s, "seconds": s / 10, "R": r, "f": 0.5, "success": r / 10} for s, r in values
    ]
    folder = pack.parent / name
    folder.mkdir()
    (folder / "config.json").write_text("{}")
    (folder / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    keep_runs(runs_in([folder]), pack)


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    """Where a pack of runs will be."""
    return tmp_path / "runs.jsonl.gz"


def test_curves_are_means_over_seeds(pack: Path) -> None:
    log(pack, "dqn-s0", [(100, 1.0), (300, 3.0), (500, 5.0)])
    log(pack, "dqn-s3", [(100, 3.0), (400, 6.0)])
    log(pack, "q-mcts-s0", [(100, 2.0)])
    (curve,) = load_curves(FIGURES["algorithms"], pack)
    assert (curve.label, curve.seeds) == ("DQN", 2)
    assert (curve.samples[0], curve.samples[-1]) == (100, 400)
    # Straight lines stay what they are, whatever the smoothing.
    np.testing.assert_allclose(curve.mean["R"], 1 + curve.samples / 100)
    np.testing.assert_allclose(curve.high["R"] - curve.low["R"], 2)
    np.testing.assert_allclose(curve.mean["f"], 0.5)


def test_the_stages_of_a_training_are_one_curve(pack: Path) -> None:
    log(pack, "dqn-s0.stage1", [(100, 1.0), (300, 3.0)])
    log(pack, "dqn-s0", [(100, 4.0), (200, 5.0)])
    (curve,) = load_curves(FIGURES["algorithms"], pack)
    assert curve.seeds == 1
    assert (curve.samples[0], curve.samples[-1]) == (100, 500)
    np.testing.assert_allclose(curve.mean["R"], curve.samples / 100)


def test_time_to_a_return_counts_those_that_never_come_there(pack: Path) -> None:
    log(pack, "dqn-s0", [(100, 1.0), (200, 2.0), (300, 3.0), (400, 4.0)])
    log(pack, "dqn-s1.stage1", [(100, 1.0), (200, 1.0)])
    log(pack, "dqn-s1", [(100, 1.0), (200, 4.0)])
    log(pack, "dqn-s2", [(100, 1.0), (400, 1.5)])
    low, high = time_to(dataclasses.replace(FIGURES["algorithms"], levels=(1.5, 3.5)), pack)
    assert (low.label, low.seeds, low.reached, high.reached) == ("DQN", 3, 3, 2)
    assert low.samples == (200, 300, 400)
    assert high.samples == (400, 400, math.inf)
    assert high.seconds == (40, 40, math.inf)


def test_smoothing_reduces_noise_and_keeps_the_mean() -> None:
    noise = np.random.default_rng(0).normal(size=200)
    smooth = curves_module._smooth(noise)
    assert smooth.shape == noise.shape
    assert smooth.std() < 0.5 * noise.std()
    assert smooth[100] == pytest.approx(noise[96:105].mean())
    assert smooth[0] == noise[0]


def test_damaged_logs_are_refused(pack: Path) -> None:
    log(pack, "dqn-s0", [(1, 1.0)])
    file = pack.parent / "dqn-s0" / "log.jsonl"
    file.write_text('{"R": 1}\n')
    keep_runs(runs_in([file.parent]), pack)
    with pytest.raises(InputError, match="entry 1"):
        read_log(read_runs(pack), "dqn-s0")
    before = pack.read_bytes()
    file.write_text('{"R": 1}\n{"samp')
    with pytest.raises(InputError, match=r"log.jsonl line 2"):
        keep_runs(runs_in([file.parent]), pack)
    assert pack.read_bytes() == before


def test_curves_command(pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log(pack, "s2v-full-s0", [(100, 1.0), (300, 3.0)])
    result, text = l2a(capsys, "curves", "architectures", "--runs", pack, "--out", tmp_path / "out")
    assert result["absent"] == ["MHA", "SHA"]
    assert "no runs of MHA, SHA" in text
    assert Path(result["picture"]).read_bytes().startswith(b"\x89PNG")


def test_sizes_and_times_come_from_the_same_rows(tmp_path: Path) -> None:
    """Every row of the figure has a time of its own; what is not measured is no number."""
    names = timed_names()
    assert len(names) == len(set(names))
    quick = next(n for n in names if n.startswith("exact look-ahead") and "3x3" in n)
    assert decision_time(quick)["ms"] > 0
    rows = load_scaled(ROOT / "results", {quick: {"ms": 7.0}})
    assert {row.label for row in rows} <= {name.rpartition(" / ")[0] for name in names}
    for row in rows:
        at = np.flatnonzero(np.isfinite(row.mean["ms"]))
        assert at.tolist() == ([0] if row.label == quick.rpartition(" / ")[0] else [])
        assert row.samples[0] == 3
    with pytest.raises(InputError, match="cells"):
        load_scaled(tmp_path, {})


def test_every_line_of_a_figure_can_be_trained() -> None:
    assert {stem for figure in FIGURES.values() for _, stem in figure.lines} <= set(RECIPES)


# What is kept of runs.


def test_a_training_is_kept_with_its_agent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing of log and configuration is lost; kept again it is the same file."""
    run = tmp_path / "runs" / "tiny-s0"
    train_recipes([TINY], run.parent, seeds=1)
    (run / "eval-easy.json").write_text('{"R": 1.5}')
    pack, agents = tmp_path / "results" / "runs.jsonl.gz", tmp_path / "agents"
    words = ["keep", run, "--runs", pack, "--agents", agents]
    result, _ = l2a(capsys, *words)
    assert result == {"runs": ["tiny-s0"], "agents": [str(agents / "tiny-s0.safetensors")]}
    bytes_ = pack.read_bytes()
    (kept,) = read_runs(pack).values()
    assert kept["config"] == json.loads((run / "config.json").read_text())
    assert kept["log"] == [
        json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()
    ]
    assert kept["evaluations"] == {"easy": {"R": 1.5}}
    trained, agent = load_agent(run), load_agent(agents / "tiny-s0.safetensors")
    assert (agent.name, agent.origin) == ("tiny-s0", trained.origin)
    for mine, theirs in zip(agent.network.parameters(), trained.network.parameters(), strict=True):
        assert torch.equal(mine, theirs)
    run.rename(run.with_name("tiny-s1.stage1"))
    result, _ = l2a(capsys, "keep", run.with_name("tiny-s1.stage1"), *words[2:])
    assert result == {"runs": ["tiny-s1.stage1"], "agents": []}
    assert list(read_runs(pack)) == ["tiny-s0", "tiny-s1.stage1"]
    run.with_name("tiny-s1.stage1").rename(run)
    pack.unlink()
    # An agent of this name is there, and then its log, too.
    for what in (str(agents / "tiny-s0.safetensors"), "tiny-s0"):
        capsys.readouterr()
        assert main([str(word) for word in words], command_line()) == 2
        said = capsys.readouterr().err
        assert f"got '{what}'" in said
        assert said.endswith("; --overwrite replaces it\n")
        l2a(capsys, *words, "--overwrite")
        assert pack.read_bytes() == bytes_


def test_the_committed_runs_say_what_was_trained() -> None:
    """Of every agent of a recipe with its tables, and each with a log to its end."""
    runs = read_runs(ROOT / "results" / "runs.jsonl.gz")
    assert len(runs) > 60
    for name, run in runs.items():
        assert {"task", "config", "seed", "commit", "hardware"} <= set(run["config"]), name
        samples = [entry["samples"] for entry in run["log"]]
        assert samples == sorted(samples), name
        assert samples, name
    agents = {name for name in agent_files() if name.rpartition("-s")[0] in RECIPES}
    assert agents <= set(runs)
