"""A Q-network, a search and a learner of one's own, trained by name."""

import sys

import torch

import learn2assemble as l2a
from learn2assemble.tasks.graph.batch import GraphTensors
from learn2assemble.tasks.networks.qnetwork import QFactors


class Perceptron(torch.nn.Module):
    """Every node alone: Q of a placement is a sum of what its two blocks are worth."""

    def __init__(self, config: l2a.NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(5, config.width),
            torch.nn.ReLU(),
            torch.nn.Linear(config.width, 2 * config.num_actions),
        )

    def forward(self, graph: GraphTensors) -> QFactors:
        """The three parts of Q of a batch of graphs."""
        block, reference = self.layers(graph.nodes).chunk(2, -1)
        context = block.new_zeros(len(block), self.config.num_actions)
        return QFactors(block, reference, context)


l2a.register_network("perceptron", Perceptron)
l2a.register_search("wide", l2a.SearchConfig(budget=4, distinct=True))
l2a.register_learner("my-dqn", l2a.Learner())
samples = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
run = l2a.train(
    "one-sided-3x3-22-24",
    out="runs/perceptron",
    config="published",
    method="my-dqn",
    settings=["network.encoder=perceptron", "augment=false", "initial_samples=64"],
    samples=samples,
)
print(l2a.evaluate(run.task, agent="runs/perceptron", search="wide", episodes=3).metrics)
