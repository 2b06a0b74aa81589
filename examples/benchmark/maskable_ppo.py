"""MaskablePPO of sb3-contrib in the benchmark: ``pip install sb3-contrib``.

    python examples/benchmark/maskable_ppo.py maskable-ppo.jsonl.gz

About a minute: it trains on random problems of a task, and plays some of the benchmark before and
after. Actions are distinct placements, masked to those that would stand.
"""

import sys

import gymnasium
import numpy as np
import torch
from sb3_contrib import MaskablePPO

import learn2assemble.envs
from learn2assemble.envs.submission import board, enter

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


def choose(observation: dict, info: dict) -> int:
    """The policy of the benchmark."""
    action, _ = model.predict(observation, action_masks=standing(info), deterministic=True)
    return int(action)


file = sys.argv[1]
steps = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
env = StandingOnly(gymnasium.make(f"learn2assemble/{TASK}-v0", actions="placements"))
model = MaskablePPO("MultiInputPolicy", env, n_steps=512, batch_size=128, seed=0)
before = enter(choose, "untrained", tasks=[TASK], problems=PROBLEMS)
model.learn(steps)
after = enter(choose, f"MaskablePPO ({steps} steps)", tasks=[TASK], problems=PROBLEMS)
print(board([before, after]))
after.write(file)
