"""MaskablePPO of sb3-contrib in the benchmark: ``pip install sb3-contrib``.

    python examples/benchmark/maskable_ppo.py maskable-ppo.jsonl.gz [steps] [seeds]

About a minute for 50,000 steps of a seed: it trains on random problems of a task, and plays some
of the benchmark. Actions are distinct placements, masked to those that would stand. Policies of
several seeds are runs of one entry. Their curves, a line every 2,048 steps, go into
``maskable-ppo.csv`` beside it.
"""

import csv
import sys
from pathlib import Path

import gymnasium
import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback

import learn2assemble.envs
from learn2assemble.envs.submission import board, enter
from learn2assemble.files import check_new

TASK, PROBLEMS = "two-sided-3x3-20-24", 20
gymnasium.register_envs(learn2assemble.envs)
torch.set_num_threads(1)  # The network is small.


def standing(info: dict) -> np.ndarray:
    """What would stand; anything legal where nothing would."""
    mask = info["physics_mask"] if info["physics_mask"].any() else info["action_masks"]
    return mask.astype(bool)


class StandingOnly(gymnasium.Wrapper):
    """Masks actions as :func:`standing` says."""

    def reset(self, **given):
        observation, self.info = self.env.reset(**given)
        return observation, self.info

    def step(self, action):
        *told, self.info = self.env.step(action)
        return *told, self.info

    def action_masks(self) -> np.ndarray:
        return standing(self.info)


class Curve(BaseCallback):
    """Keeps the mean return of the last 50 episodes every so often."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.seed = seed

    def _on_step(self) -> bool:
        if self.n_calls % 2048 == 0:
            found = np.mean([one["r"] for one in self.model.ep_info_buffer])
            curves.append((self.seed, self.n_calls, round(float(found), 3)))
            print(f"seed {self.seed}: {self.n_calls} steps, return {found:.2f}", flush=True)
        return True


class Learned:
    """A policy of the benchmark."""

    def __init__(self, seed: int, steps: int) -> None:
        env = StandingOnly(gymnasium.make(f"learn2assemble/{TASK}-v0", actions="placements"))
        self.model = MaskablePPO(
            "MultiInputPolicy", env, n_steps=512, batch_size=128, seed=seed, stats_window_size=50
        )
        self.model.learn(steps, callback=Curve(seed))

    def __call__(self, observation: dict, info: dict) -> int:
        action, _ = self.model.predict(observation, action_masks=standing(info), deterministic=True)
        return int(action)


file, *given = sys.argv[1:]
beside = Path(file).with_name(Path(file).name.partition(".")[0] + ".csv")
for path in Path(file), beside:
    check_new(path, "FILE")  # Before hours of training.
curves: list[tuple[int, int, float]] = []
steps, seeds = (*map(int, given), *(10_000, 1)[len(given) :])
policies = [Learned(seed, steps) for seed in range(seeds)]
entry = enter(policies, f"MaskablePPO ({steps} steps)", tasks=[TASK], problems=PROBLEMS)
print(board([entry]))
entry.write(file)
with beside.open("w", newline="") as rows:
    csv.writer(rows).writerows([("seed", "steps", "return"), *curves])
