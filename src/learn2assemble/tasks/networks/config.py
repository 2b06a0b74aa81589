"""What a Q-network is made of, and the kinds of networks by name."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from learn2assemble.constants import EDGE
from learn2assemble.errors import InputError, check_fields, check_name, check_types
from learn2assemble.registry import Registry
from learn2assemble.tasks.world.blocks import ACTION_MODES


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture of a Q-network.

    Args:
        width: F, embedding size.
        encoder: name of the kind of network, see :data:`NETWORKS`: ``attention``, ``s2v``
            (Structure2Vec), ``relational`` (ours) or a registered one; ``heads``,
            ``feed_forward`` and ``rotary`` belong to ``attention``, ``connectivity`` and
            ``position_scale`` to the first two.
        heads: attention heads; key and value size is ``width / heads``.
        rounds: L, rounds of message passing with their own weights.
        feed_forward: ``light`` is the paper's 64->64 layer with ReLU (equation 2), ``wide`` the
            published 64->512->64, ``none`` leaves it out.
        connectivity: ``partial`` or ``full``.
        num_actions: Na.
        action_mode: what the ways of an action are, :attr:`Task.action_mode`; counts for
            ``relational`` only, like ``pitch``.
        pitch: horizontal distance of neighbouring blocks of the task [m].
        sight: cells of ``relational`` do not look at blocks farther than this many cells along
            any axis; 0: at all. See :attr:`Task.sight`.
        hand: whether a placement also knows what is around the hand, and where in the world it is
            (:mod:`learn2assemble.tasks.graph.relations`); for ``relational``, where an arm builds.
        position_scale: positions are divided by this [m] (1.025 in the published code).
        rotary: rotate queries and keys by the node positions, so that attention scores depend on
            offsets between nodes instead of absolute positions (deviation D5).
    """

    width: int = 64
    heads: int = 4
    rounds: int = 3
    feed_forward: str = "light"
    connectivity: str = "partial"
    num_actions: int = 5
    action_mode: str = "turns"
    pitch: float = EDGE
    sight: int = 0
    hand: bool = False
    position_scale: float = 1.025
    rotary: bool = False
    encoder: str = "attention"

    def __post_init__(self) -> None:
        check_types(self)
        whole = {"width": 4096, "heads": 4096, "rounds": 100, "num_actions": 1000}
        for name, valid in NAMES.items():
            check_name(name, getattr(self, name), valid)
        check_fields(
            self,
            *(
                (name, 1 <= getattr(self, name) <= most, f"a whole number from 1 to {most}")
                for name, most in whole.items()
            ),
            ("pitch", 0 < self.pitch < math.inf, "a positive length [m]"),
            ("sight", 0 <= self.sight <= 1000, "a whole number from 0 to 1000"),
            ("position_scale", 0 < self.position_scale < math.inf, "a positive length [m]"),
        )
        s2v, relational = self.encoder == "s2v", self.encoder == "relational"
        check_fields(
            self,
            ("heads", self.width % self.heads == 0, f"a divisor of width {self.width}"),
            ("width", not s2v or self.width >= 2, "at least 2 for the encoder s2v"),
            ("rotary", not (s2v and self.rotary), "false for the encoder s2v (it has no scores)"),
            ("hand", relational or not self.hand, "false unless encoder is relational"),
        )

    @property
    def values_placements(self) -> bool:
        """Whether the network values distinct placements instead of pairs of nodes."""
        return NETWORKS[self.encoder].values_placements


@dataclass(frozen=True)
class NetworkKind:
    """A kind of Q-network.

    Args:
        make: an untrained network of a configuration: a ``torch.nn.Module`` that keeps it as
            ``config`` and maps :class:`~learn2assemble.tasks.graph.batch.GraphTensors` to
            :class:`~learn2assemble.tasks.networks.qnetwork.QFactors`, or to
            :class:`~learn2assemble.tasks.networks.placement.PlacementValues`.
        values_placements: it is the latter; such networks can learn from a model's labels.
    """

    make: Callable[[NetworkConfig], Any]
    values_placements: bool = False


def _imported(module: str, name: str) -> Callable[[NetworkConfig], Any]:
    """Makes networks of a class; PyTorch is loaded only by those who ask for one."""
    return lambda config: getattr(importlib.import_module(module), name)(config)


_published = NetworkKind(_imported("learn2assemble.tasks.networks.qnetwork", "QNetwork"))
_relational = _imported("learn2assemble.tasks.networks.placement", "PlacementNetwork")
NETWORKS: Registry[NetworkKind] = Registry(
    "network",
    {
        "attention": _published,
        "s2v": _published,
        "relational": NetworkKind(_relational, values_placements=True),
    },
)
NAMES: dict[str, Collection[str]] = {
    "feed_forward": ("light", "wide", "none"),
    "encoder": NETWORKS,
    "connectivity": ("partial", "full"),
    "action_mode": ACTION_MODES,
}
"""What fields of a configuration can be called."""


def register_network(
    name: str, make: Callable[[NetworkConfig], Any], *, values_placements: bool = False
) -> None:
    """Make a kind of network known as ``encoder`` of :class:`NetworkConfig`.

    Agents that were saved with it can be loaded once it is registered.

    Args:
        make, values_placements: see :class:`NetworkKind`.

    Raises:
        InputError: for a name that is taken.
    """
    if not callable(make):
        raise InputError("make", make, "a function of a NetworkConfig")
    NETWORKS.register(name, NetworkKind(make, values_placements))
