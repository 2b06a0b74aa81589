"""A task of one's own, with objects of one's own, known to everything by its name."""

import gymnasium

import learn2assemble as l2a
import learn2assemble.envs

l2a.register_object_set(
    "corners", [["cube"], ["corner"]], {"corner": l2a.Shape(((0, 0, 0), (1, 0, 0), (0, 1, 0)))}
)
task = l2a.register_task(
    l2a.Task(
        "my-corners",
        num_sides=2,
        grid=4,
        num_nodes=30,
        objects="corners",
        rotations=4,
        layout="narrow-field",
        reward="scaled",
        success_threshold=0.75,
        stability="object",
    )
)
print(l2a.evaluate("my-corners", agent="relational-objects-s0", episodes=3).metrics)
gymnasium.register_envs(learn2assemble.envs)
env = gymnasium.make("learn2assemble/my-corners-v0")
_, info = env.reset(seed=0)
env.step(env.action_space.sample(info["action_masks"]))
print(env.unwrapped.task.block_range)
