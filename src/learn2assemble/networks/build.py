"""A Q-network from its configuration."""

from __future__ import annotations

from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.placement import PlacementNetwork, PlacementValues
from learn2assemble.networks.qnetwork import QFactors, QNetwork

Network = QNetwork | PlacementNetwork
Values = QFactors | PlacementValues


def make_network(config: NetworkConfig) -> Network:
    """The published networks, or the placement network for the encoder ``relational``."""
    return PlacementNetwork(config) if config.encoder == "relational" else QNetwork(config)
