"""Offline behaviour cloning from demonstrations: ``pip install "minari[hdf5]"``.

    l2a demonstrate two-sided-3x3-20-24 --episodes 1000 --out out/demonstrations
    python examples/benchmark/behaviour_cloning.py out/demonstrations cloned.jsonl.gz

About two minutes: it learns which of the distinct placements the demonstrator chose, from states
alone, and plays some of the benchmark before and after. What is not legal is masked; what would
stand is not known to it.
"""

import os
import sys
from pathlib import Path

import numpy as np
import torch
from torch import nn

from learn2assemble.envs.submission import board, enter
from learn2assemble.files import check_new

folder, file = sys.argv[1:3]
check_new(Path(file), "FILE")  # Before the training.
epochs = int(sys.argv[3]) if len(sys.argv) > 3 else 8
problems = int(sys.argv[4]) if len(sys.argv) > 4 else 20
TASK = "two-sided-3x3-20-24"
os.environ["MINARI_DATASETS_PATH"] = os.path.abspath(folder)
torch.manual_seed(0)
torch.set_num_threads(1)  # The network is small.

import minari  # noqa: E402 - it reads the variable above

import learn2assemble.envs  # noqa: E402, F401 - registers the environments


class Scores(nn.Module):
    """A score for every placement, from where the nodes of the graph lie around it."""

    def __init__(self, width: int = 32):
        super().__init__()
        self.node = nn.Sequential(nn.Linear(5, width), nn.ReLU())
        self.out = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, nodes, used, placements, offered):
        """nodes [B, N, 5], used bool[B, N], placements [B, A, 3], offered bool[B, A]: [B, A]."""
        around = nodes[:, None, :, :3] - placements[:, :, None]
        flags = nodes[:, None, :, 3:].expand(*around.shape[:3], 2)
        seen = self.node(torch.cat([20 * around, flags], -1))  # In block edges.
        there = used[:, None, :, None]
        near = torch.exp(-200 * around.square().sum(-1, keepdim=True)) * there
        pooled = torch.cat([(seen * there).amax(2), (seen * near).sum(2)], -1)
        return self.out(pooled)[..., 0].masked_fill(~offered, -1e9)


def tensors(observations: dict, masks: np.ndarray) -> tuple:
    """What the network takes, of many states."""
    count = np.asarray(observations["num_nodes"])
    nodes = torch.tensor(np.asarray(observations["nodes"]))
    used = torch.arange(nodes.shape[1]) < torch.tensor(count)[:, None]
    placements = torch.tensor(np.asarray(observations["placements"]))
    return nodes, used, placements, torch.tensor(np.asarray(masks)).bool()


def choose(observation: dict, info: dict) -> int:
    """The policy of the benchmark."""
    with torch.no_grad():
        scores = model(
            *tensors({k: v[None] for k, v in observation.items()}, info["action_masks"][None])
        )
    return int(scores.argmax())


name = next(name for name in minari.list_local_datasets() if f"/{TASK}/" in name)
data = minari.load_dataset(name)
parts = [(e.observations, e.infos["action_masks"], e.actions) for e in data.iterate_episodes()]
states = {k: np.concatenate([seen[k][:-1] for seen, _, _ in parts]) for k in parts[0][0]}
given = tensors(states, np.concatenate([masks[:-1] for _, masks, _ in parts]))
chosen = torch.tensor(np.concatenate([actions for _, _, actions in parts]))
print(f"{name}: {len(parts)} episodes, {len(chosen)} actions")

model = Scores()
before = enter(choose, "untrained", tasks=[TASK], problems=problems)
optimiser = torch.optim.Adam(model.parameters(), 1e-3)
for epoch in range(epochs):
    total = 0.0
    for rows in torch.randperm(len(chosen)).split(64):
        loss = nn.functional.cross_entropy(model(*[part[rows] for part in given]), chosen[rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        total += loss.item() * len(rows)
    print(f"epoch {epoch + 1}: loss {total / len(chosen):.3f}", flush=True)
after = enter(choose, f"behaviour cloning ({len(parts)} episodes)", tasks=[TASK], problems=problems)
print(board([before, after]))
after.write(file)
