"""MaskablePPO of sb3-contrib in the benchmark: ``pip install sb3-contrib``.

    python examples/benchmark/maskable_ppo.py maskable-ppo.jsonl.gz [SEEDS] [TASK=STEPS ...]

About a minute for 50,000 steps of a seed: it trains on random problems of each task (of designs,
on those of the families of training, out of a pool of them), and plays some of the benchmark.
Actions are masked to those that would stand, where that is told; of the candidates of a design or
of goals it sees the first 32. Policies of several seeds are runs of one entry. Their curves, a line
every 2,048 steps, go into ``maskable-ppo.csv`` beside it.
"""

import csv
import sys
from pathlib import Path

import gymnasium
import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback

from learn2assemble.envs.submission import board, enter
from learn2assemble.envs.suite import SuiteTask
from learn2assemble.files import check_new

TASKS, PROBLEMS, POOL, MOST = ["two-sided-3x3-20-24=10000"], 20, 20, 32
torch.set_num_threads(1)  # The network is small.


def seen(observation: dict) -> dict:
    """What it sees: of many candidates the first."""
    if "candidates" not in observation:
        return observation
    return {"candidates": observation["candidates"][:MOST], "summary": observation["summary"]}


def standing(info: dict, most: int) -> np.ndarray:
    """What would stand; anything legal where nothing would, or nobody tells."""
    told = info.get("physics_mask", info["action_masks"])
    return (told if told.any() else info["action_masks"])[:most].astype(bool)


class Seen(gymnasium.Wrapper):
    """Shows what :func:`seen` says, and masks actions as :func:`standing` does."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        if "candidates" in (shown := env.observation_space.spaces):
            rows = gymnasium.spaces.Box(-np.inf, np.inf, (MOST, shown["candidates"].shape[1]))
            space = {"candidates": rows, "summary": shown["summary"]}
            self.observation_space = gymnasium.spaces.Dict(space)
            self.action_space = gymnasium.spaces.Discrete(MOST)

    def reset(self, **given):
        observation, self.info = self.env.reset(**given)
        return seen(observation), self.info

    def step(self, action):
        observation, *told, self.info = self.env.step(action)
        return seen(observation), *told, self.info

    def action_masks(self) -> np.ndarray:
        return standing(self.info, int(self.action_space.n))


class Curve(BaseCallback):
    """Keeps the mean return of the last 50 episodes every so often."""

    def __init__(self, task: str, seed: int) -> None:
        super().__init__()
        self.of = (task, seed)

    def _on_step(self) -> bool:
        if self.n_calls % 2048 == 0:
            found = np.mean([one["r"] for one in self.model.ep_info_buffer])
            curves.append((*self.of, self.n_calls, round(float(found), 3)))
            print(*self.of, f"{self.n_calls} steps, return {found:.2f}", flush=True)
        return True


def train(task: str, seed: int, steps: int) -> MaskablePPO:
    """A policy of a task."""
    env = SuiteTask(task).make()
    if task.startswith("designs-"):
        env = type(env)(task.removesuffix("-held-out"), pool=POOL)
    model = MaskablePPO(
        "MultiInputPolicy", Seen(env), n_steps=512, batch_size=128, seed=seed, stats_window_size=50
    )
    return model.learn(steps, callback=Curve(task, seed))


class Learned:
    """A policy of the benchmark, one model for each task."""

    knows = "observation"

    def __init__(self, seed: int) -> None:
        self.models = {task: train(task, seed, steps) for task, steps in tasks.items()}

    def begin(self, env: gymnasium.Env) -> None:
        self.model = self.models[env.task.name]

    def __call__(self, observation: dict, info: dict) -> int:
        mask = standing(info, int(self.model.action_space.n))
        action, _ = self.model.predict(seen(observation), action_masks=mask, deterministic=True)
        return int(action)


file, *given = sys.argv[1:]
beside = Path(file).with_name(Path(file).name.partition(".")[0] + ".csv")
for path in Path(file), beside:
    check_new(path, "FILE")  # Before hours of training.
curves: list[tuple[str, int, int, float]] = []
seeds = int(given[0]) if given else 1
tasks = {task: int(steps) for task, steps in (one.split("=") for one in given[1:] or TASKS)}
policies = [Learned(seed) for seed in range(seeds)]
entry = enter(policies, "MaskablePPO", tasks=list(tasks), problems=PROBLEMS)
print(board([entry]))
entry.write(file)
with beside.open("w", newline="") as rows:
    csv.writer(rows).writerows([("task", "seed", "steps", "return"), *curves])
