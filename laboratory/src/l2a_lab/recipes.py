"""Trainings by name: what it takes to make each agent behind the tables.

A recipe is a task and one or more stages; a stage starts from the agent of the one before it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from l2a_lab.runs import STAGE, keep_runs, runs_in
from learn2assemble.errors import InputError
from learn2assemble.tasks.learning.config import CONFIGS, TrainConfig, fit_to, override
from learn2assemble.tasks.learning.run import run_training
from learn2assemble.tasks.networks.agent import load_agent, one_thread
from learn2assemble.tasks.task import get_task
from learn2assemble.workers import run_all

SEEDS = 5
"""Agents of a published row."""


@dataclass(frozen=True)
class RecipeStage:
    """A named configuration, fitted to the task, with some settings changed (``KEY=VALUE``)."""

    config: str = "published"
    changes: tuple[str, ...] = ()

    def resolve(self, task: str) -> TrainConfig:
        return override(fit_to(CONFIGS[self.config], get_task(task)), list(self.changes))


@dataclass(frozen=True)
class Recipe:
    """How the agents ``NAME-s0``, ``NAME-s1``, ... are made."""

    name: str
    task: str
    stages: tuple[RecipeStage, ...] = (RecipeStage(),)
    seeds: int = SEEDS


_CUBES, _LARGE = "two-sided-3x3-20-24", "two-sided-5x5-40-44"
_ROBOT_TWO, _ROBOT_FOUR = "robot-two-sided-3x3-10-14", "robot-four-sided-3x3-10-18"
_ROBOT_ANYWHERE = "robot-random-two-sided-3x3-10-14"
_ROBOT_OBJECTS = "robot-objects-two-sided-5x5-20-24"
_ROBOT_ONE = "robot-one-sided-5x5-15-17"
_WALLS = "robot-walls-two-sided-5x5-26-30"
_BARS, _OBJECTS = "bars-one-sided-5x5-25-27", "objects-two-sided-5x5-20-24"


_FULL = "network.connectivity=full"
_EDGES = "network.position_scale=0.08"
"""Positions in about block edges instead of metres (deviation D34)."""
_FAST = (_EDGES, "num_samples=100000")
_SHORTER = "num_samples=160000"
_SHORT = "num_samples=60000"
_NO_HAND = "network.hand=false"
"""Of two sides a hand needs no view of its own: both show which way its fingers close."""
_AGAIN = ("learning_rate=0.001", "final_learning_rate=0.00003", "epsilon_samples=1")
"""A later stage: half the learning rate, and no more exploration than the first ends with."""

_IN_FAST_MODE = (
    "physics=published",
    "num_samples=60000",
    "epsilon_samples=1",
    "updates_per_round=50",
)
"""A later stage in the authors' fast mode, with two gradient steps for each of theirs."""


def _published(name: str, task: str, *changes: str) -> Recipe:
    return Recipe(name, task, (RecipeStage(changes=changes),))


_ALL = (
    _published("dqn", _CUBES, *_FAST),
    Recipe("dqn-paper", _CUBES, (RecipeStage("paper"),)),
    _published("q-mcts", _CUBES, *_FAST, "method=q-mcts"),
    _published("eps-mcts", _CUBES, *_FAST, "method=eps-mcts"),
    _published("mha-full", _CUBES, _FULL, _EDGES, "num_samples=120000"),
    _published("sha-full", _CUBES, _FULL, _EDGES, "num_samples=120000", "network.heads=1"),
    _published("s2v-full", _CUBES, _FULL, *_FAST, "network.encoder=s2v"),
    _published("bars-full", _BARS, _FULL, _EDGES),
    _published("bars-partial", _BARS, _EDGES),
    _published("objects", _OBJECTS, _EDGES, "num_samples=480000"),
    _published("robot-two-sided", _ROBOT_TWO),
    Recipe("robot-two-sided-paper", _ROBOT_TWO, (RecipeStage("paper"),)),
    Recipe("robot-four-sided-paper", _ROBOT_FOUR, (RecipeStage("paper"),)),
    Recipe("robot-four-sided", _ROBOT_FOUR, (RecipeStage(), RecipeStage(changes=_AGAIN))),
    Recipe("robot-objects-paper", _ROBOT_OBJECTS, (RecipeStage("paper"),)),
    Recipe(
        "robot-objects-fast-mode",
        _ROBOT_OBJECTS,
        (RecipeStage("paper"), RecipeStage("paper", _IN_FAST_MODE)),
        seeds=3,
    ),
    Recipe("robot-one-sided-paper", _ROBOT_ONE, (RecipeStage("paper"),)),
    _published("robot-objects", _ROBOT_OBJECTS),
    _published("robot-one-sided", _ROBOT_ONE, _SHORTER),
    _published("one-sided", "one-sided-5x5-15-17", _SHORTER),
    Recipe("relational-cubes", _LARGE, (RecipeStage("relational", ("num_samples=120000",)),)),
    Recipe("relational-small", _CUBES, (RecipeStage("relational", (_SHORT,)),)),
    Recipe("relational-bars", _BARS, (RecipeStage("relational", (_SHORT,)),)),
    Recipe("relational-objects", _OBJECTS, (RecipeStage("relational-objects"),)),
    Recipe("relational-two-sided", _ROBOT_TWO, (RecipeStage("relational", (_SHORT, _NO_HAND)),)),
    Recipe(
        "relational-anywhere", _ROBOT_ANYWHERE, (RecipeStage("relational", (_SHORT, _NO_HAND)),)
    ),
    Recipe("relational-four-sided", _ROBOT_FOUR, (RecipeStage("relational"),)),
    Recipe("relational-one-sided", _ROBOT_ONE, (RecipeStage("relational"),), seeds=3),
    Recipe("relational-walls", _WALLS, (RecipeStage("relational", (_SHORT,)),)),
    Recipe(
        "relational-robot-objects", _ROBOT_OBJECTS, (RecipeStage("relational-objects"),), seeds=3
    ),
)

RECIPES: dict[str, Recipe] = {recipe.name: recipe for recipe in _ALL}


def train_recipes(
    recipes: list[Recipe],
    runs: Path,
    *,
    seeds: int | None = None,
    workers: int = 1,
    ray: str | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Train the agents of ``recipes`` into ``runs/NAME-sSEED``; what is there is continued.

    Args:
        seeds: agents of every recipe; by default as many as it says.
        workers, ray: trainings at once, one thread each; see
            :func:`learn2assemble.workers.run_all`.

    Raises:
        InputError: for a folder that belongs to another training.
        UnknownNameError: for a task that is not a preset.
    """
    work = [(r, seed, runs) for seed in range(SEEDS) for r in recipes if seed < (seeds or r.seeds)]
    for recipe, seed, _ in work:
        get_task(recipe.task)
        for number, stage in enumerate(recipe.stages):
            _check(stage_folder(recipe, seed, runs, number), recipe, stage)
    progress(f"{len(work)} trainings in {runs}, {min(workers, len(work))} at a time")
    with one_thread():
        for _, text in run_all(_train, work, workers=workers, ray=ray):
            progress(text)


def stage_folder(recipe: Recipe, seed: int, runs: Path, stage: int) -> Path:
    """Folder of a stage; the last one has the name of the agent."""
    early = f"{STAGE}{stage + 1}" if stage + 1 < len(recipe.stages) else ""
    return runs / f"{recipe.name}-s{seed}{early}"


def keep_logs(recipes: list[Recipe], runs: Path, pack: Path) -> None:
    """Put configuration and log of every run of ``recipes`` into a pack, for learning curves."""
    folders = [
        stage_folder(recipe, seed, runs, number)
        for recipe in recipes
        for seed in range(SEEDS)
        for number in range(len(recipe.stages))
    ]
    keep_runs(runs_in(f for f in folders if (f / "log.jsonl").is_file()), pack)


def _check(folder: Path, recipe: Recipe, stage: RecipeStage) -> None:
    """Refuse to continue what was started with another configuration."""
    file = folder / "config.json"
    if not file.is_file():
        return
    try:
        saved = json.loads(file.read_text(encoding="utf-8"))
        same = (saved["task"]["name"], TrainConfig.from_dict(saved["config"])) == (
            recipe.task,
            stage.resolve(recipe.task),
        )
    except (ValueError, KeyError, TypeError):
        same = False
    if not same:
        raise InputError("--runs", str(folder), f"a run of the recipe {recipe.name}")


def _train(job: tuple[Recipe, int, Path]) -> str:
    recipe, seed, runs = job
    metrics, init = {}, None
    for number, stage in enumerate(recipe.stages):
        folder = stage_folder(recipe, seed, runs, number)
        resume = (folder / "state.safetensors").is_file()
        metrics = run_training(
            get_task(recipe.task),
            stage.resolve(recipe.task),
            folder,
            seed=seed,
            device="cpu",
            resume=resume,
            init=None if resume else init,
            quiet=True,
        )
        init = load_agent(str(folder))
    return f"{recipe.name}-s{seed}: R {metrics.get('R', float('nan')):.2f} in training"
