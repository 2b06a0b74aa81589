"""A Q-network from its configuration."""

from __future__ import annotations

import copy
import dataclasses

from learn2assemble.networks.config import NetworkConfig
from learn2assemble.networks.placement import PlacementNetwork, PlacementValues
from learn2assemble.networks.qnetwork import QFactors, QNetwork

Network = QNetwork | PlacementNetwork
Values = QFactors | PlacementValues


def make_network(config: NetworkConfig) -> Network:
    """The published networks, or the placement network for the encoder ``relational``."""
    return PlacementNetwork(config) if config.encoder == "relational" else QNetwork(config)


def at_pitch(network: Network, pitch: float) -> Network:
    """The network for blocks at another distance [m]; weights are shared.

    What it has learned in block edges may hold on another lattice, too.
    """
    if network.config.pitch == pitch:
        return network
    other = copy.copy(network)
    other.config = dataclasses.replace(network.config, pitch=pitch)
    return other
