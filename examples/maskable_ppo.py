"""Train with MaskablePPO of sb3-contrib: ``pip install sb3-contrib``.

About a minute; what it says in the end is what the agent does on problems it was not trained on.
"""

import sys

import gymnasium
import torch
from sb3_contrib import MaskablePPO

import learn2assemble.envs

gymnasium.register_envs(learn2assemble.envs)
EPISODES = 20
torch.set_num_threads(1)  # The network is small.


def play(model: MaskablePPO) -> float:
    """Mean return over problems that are the same for every model."""
    total = 0.0
    for seed in range(EPISODES):
        observation, _ = env.reset(seed=10_000 + seed)
        ended = False
        while not ended:
            masks = env.get_wrapper_attr("action_masks")()
            action, _ = model.predict(observation, action_masks=masks, deterministic=True)
            observation, reward, ended, _, _ = env.step(int(action))
            total += float(reward)
    return total / EPISODES


steps = int(sys.argv[1]) if len(sys.argv) > 1 else 6_000
env = gymnasium.make("learn2assemble/one-sided-3x3-22-24-v0", physics_mask=True)
model = MaskablePPO("MultiInputPolicy", env, n_steps=256, batch_size=64, seed=0)
before = play(model)
model.learn(steps)
after = play(model)
learned = "it has learned" if after > before else "it has learned nothing yet: give it more steps"
print(f"mean return {before:.2f} before, {after:.2f} after {steps} steps: {learned}")
