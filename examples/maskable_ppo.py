"""Train with MaskablePPO of sb3-contrib: ``pip install sb3-contrib``."""

import sys

import gymnasium
from sb3_contrib import MaskablePPO

import learn2assemble  # noqa: F401 - registers the environments

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
env = gymnasium.make("learn2assemble/one-sided-3x3-22-24-v0", physics_mask=False)
model = MaskablePPO("MultiInputPolicy", env, n_steps=64, batch_size=32, seed=0)
model.learn(steps)
observation, _ = env.reset(seed=1)
ended, total = False, 0.0
while not ended:
    masks = env.get_wrapper_attr("action_masks")()
    action, _ = model.predict(observation, action_masks=masks, deterministic=True)
    observation, reward, ended, _, info = env.step(int(action))
    total += float(reward)
print(f"return {total:.2f}, coverage {info['coverage']:.2f}")
