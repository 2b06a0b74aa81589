"""Many worlds stepped as one batch."""

import gymnasium
import numpy as np

import learn2assemble.envs

gymnasium.register_envs(learn2assemble.envs)
envs = gymnasium.make_vec("learn2assemble/two-sided-3x3-20-24-v0", num_envs=64)
_, info = envs.reset(seed=0)
rng, returns = np.random.default_rng(0), np.zeros(64)
for _ in range(20):
    good = info["physics_mask"]
    masks = np.where(good.any(1, keepdims=True), good, info["action_masks"])
    actions = [int(rng.choice(np.flatnonzero(mask))) if mask.any() else 0 for mask in masks]
    _, rewards, _, _, info = envs.step(np.array(actions))
    returns += rewards
print(f"mean return of 20 steps by the physics mask: {returns.mean():.2f}")
