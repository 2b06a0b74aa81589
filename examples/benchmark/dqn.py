"""Double DQN in the benchmark, without a library for it, on designs, goals and hidden errors.

    python examples/benchmark/dqn.py dqn-candidates.jsonl.gz [SEEDS] [TASK=STEPS ...]

A network tells what an action is worth from what the task says of it: the row of a candidate, or
its number where actions have no rows, beside what the task says of the state. It may take what
would stand, where that is told. It trains on random problems of each task (of designs, on those of
the families of training, out of a pool of them), and plays some of the benchmark. Policies of
several seeds are runs of one entry. Their curves, a line every 2,000 steps, go into a table beside
it.
"""

import copy
import csv
import functools
import sys
from collections import deque
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from learn2assemble.envs.submission import board, enter
from learn2assemble.envs.suite import SuiteTask
from learn2assemble.files import check_new

TASKS, PROBLEMS, POOL = ["designs-lintels-60-held-out=20000"], 20, 200
DISCOUNT, BATCH, MEMORY, RATE, RENEWED = 0.99, 64, 10_000, 5e-4, 250
MOST = 64
"""Of so many actions of a state that is remembered, drawn at random, the best is looked for."""
torch.set_num_threads(1)  # The network is small.


class Choice(NamedTuple):
    """What can be done in a state."""

    state: np.ndarray
    """float32[S]: what the task says of the state."""
    actions: np.ndarray
    """int[K]: numbers of actions that would stand; that are legal, where nobody tells."""
    rows: np.ndarray
    """float32[K, F]: what it says of each of them."""

    @classmethod
    def of(cls, observation: dict, info: dict) -> "Choice":
        """From what a policy is told."""
        told = info.get("physics_mask", info["action_masks"])
        actions = np.flatnonzero(told if told.any() else info["action_masks"])
        if "candidates" in observation:
            return cls(observation["summary"], actions, observation["candidates"][actions])
        state = np.concatenate([np.ravel(one) for one in observation.values()])
        return cls(state, actions, np.eye(len(told), dtype=np.float32)[actions])

    def fewer(self, rng: np.random.Generator) -> "Choice":
        """The same with at most :data:`MOST` of the actions."""
        kept = rng.permutation(len(self.actions))[:MOST]
        return Choice(self.state, self.actions[kept], self.rows[kept])


class Value(nn.Module):
    """What actions are worth: an MLP over the state and the row of each."""

    def __init__(self, choice: Choice) -> None:
        super().__init__()
        wide = choice.state.size + choice.rows.shape[1]
        self.layers = nn.Sequential(
            nn.LayerNorm(wide),
            nn.Linear(wide, 128),
            nn.ReLU(),
            nn.Linear(128, 128),
            nn.ReLU(),
            nn.Linear(128, 1),
        )

    def forward(self, choices: list[Choice]) -> list[torch.Tensor]:
        """float[K] of each."""
        sizes = [len(one.actions) for one in choices]
        states = np.repeat(np.stack([one.state for one in choices]), sizes, axis=0)
        seen = np.concatenate([states, np.concatenate([one.rows for one in choices])], axis=1)
        return list(self.layers(torch.from_numpy(seen)).squeeze(1).split(sizes))

    @torch.no_grad()
    def best(self, choice: Choice) -> int:
        """Which of the actions is worth most."""
        return int(self([choice])[0].argmax())


def learn(net: Value, target: Value, optimiser: torch.optim.Optimizer, batch: list) -> None:
    """One step of double DQN: ``net`` chooses what comes next, ``target`` says what it is worth."""
    done, rewards, nexts = zip(*batch, strict=True)
    worth = torch.tensor(rewards, dtype=torch.float32)
    with torch.no_grad():
        on = [k for k, one in enumerate(nexts) if one is not None]
        after = [nexts[k] for k in on]
        if after:
            for k, mine, theirs in zip(on, net(after), target(after), strict=True):
                worth[k] += DISCOUNT * theirs[mine.argmax()]
    loss = nn.functional.smooth_l1_loss(torch.cat(net(list(done))), worth)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()


@functools.cache
def trained_on(task: str):
    """The environment, with one pool for all seeds: large designs take seconds to draw."""
    env = SuiteTask(task).make()
    if task.startswith("designs-"):
        env = type(env)(task.removesuffix("-held-out"), pool=POOL)
    env.reset(seed=0)
    return env


def train(task: str, seed: int, steps: int) -> Value:
    """A network for a task; a random action in place of its own at first always, later seldom."""
    env = trained_on(task)
    torch.manual_seed(seed)
    rng, env.np_random = np.random.default_rng(seed), np.random.default_rng(seed)
    choice = Choice.of(*env.reset())
    net = Value(choice)
    target, optimiser = copy.deepcopy(net), torch.optim.Adam(net.parameters(), RATE)
    memory, returns, total = deque(maxlen=MEMORY), deque(maxlen=50), 0.0
    for step in range(1, steps + 1):
        explores = rng.random() < max(1 - step / (0.5 * steps), 0.05)
        k = int(rng.integers(len(choice.actions))) if explores else net.best(choice)
        done = Choice(choice.state, choice.actions[[k]], choice.rows[[k]])
        observation, reward, ended, cut, info = env.step(choice.actions[k])
        total += float(reward)
        if not ended:
            choice = Choice.of(observation, info)
        memory.append((done, float(reward), None if ended else choice.fewer(rng)))
        if ended or cut:
            returns.append(total)
            total, choice = 0.0, Choice.of(*env.reset())
        if step >= 1000 and step % 2 == 0:
            learn(
                net, target, optimiser, [memory[k] for k in rng.integers(len(memory), size=BATCH)]
            )
        if step % RENEWED == 0:
            target.load_state_dict(net.state_dict())
        if step % 2000 == 0:
            curves.append((task, seed, step, round(float(np.mean(returns)), 3)))
            print(*curves[-1], flush=True)
    return net


class Learned:
    """A policy of the benchmark, one network for each task."""

    knows = "observation"

    def __init__(self, seed: int) -> None:
        self.nets = {task: train(task, seed, steps) for task, steps in tasks.items()}

    def begin(self, env) -> None:
        self.net = self.nets[env.task.name]

    def __call__(self, observation: dict, info: dict) -> int:
        choice = Choice.of(observation, info)
        return int(choice.actions[self.net.best(choice)])


if __name__ == "__main__":
    file, *given = sys.argv[1:]
    beside = Path(file).with_name(Path(file).name.partition(".")[0] + ".csv")
    for path in Path(file), beside:
        check_new(path, "FILE")  # Before hours of training.
    curves: list[tuple[str, int, int, float]] = []
    seeds = int(given[0]) if given else 1
    tasks = {task: int(steps) for task, steps in (one.split("=") for one in given[1:] or TASKS)}
    policies = [Learned(seed) for seed in range(seeds)]
    entry = enter(policies, "DQN over candidates", tasks=list(tasks), problems=PROBLEMS)
    print(board([entry]))
    entry.write(file)
    with beside.open("w", newline="") as rows:
        csv.writer(rows).writerows([("task", "seed", "steps", "return"), *curves])
