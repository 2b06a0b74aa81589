"""The network that scores the candidates of the builder of designs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.planning.agent.features import NUM_FEATURES, NUM_SUMMARY
from learn2assemble.planning.scorer import (
    Scorer,
    ScorerFiles,
    Shapes,
    layer_shapes,
    random_weights,
    two_layers,
)

FOLDER = Path(__file__).parents[2] / "assets" / "builders"
"""The builders that come with the package."""
DEFAULT = "builder-s0"
"""The agent that builds where none is named."""
MAX_LOGIT = 30.0


class Builder(Scorer):
    """Weights of a builder and their origin."""

    def scores(self, candidates: np.ndarray, summary: np.ndarray) -> np.ndarray:
        """Logits of candidates.

        Args:
            candidates: float32[m, NUM_FEATURES].
            summary: float32[NUM_SUMMARY].
        """
        return forward(self.weights, candidates, summary[None])


def forward(weights: Any, candidates: Any, summary: Any) -> Any:
    """Logits of candidates [..., m]; arguments as :func:`~..scorer.two_layers`."""
    hidden = two_layers(weights, candidates, summary)
    return (hidden @ weights["score"] + weights["score_bias"]).clip(-MAX_LOGIT, MAX_LOGIT)[..., 0]


def _shapes(hidden: int, width: int) -> Shapes:
    return {**layer_shapes(NUM_FEATURES, NUM_SUMMARY, hidden, width), "score_bias": (1,)}


_FILES = ScorerFiles("learn2assemble-builder", "builder of designs", FOLDER, _shapes)


def initial_weights(seed: int, hidden: int = 128, width: int = 64) -> dict[str, np.ndarray]:
    """Random weights.

    Args:
        hidden, width: of the first and of the second layer.
    """
    return random_weights(_shapes(hidden, width), seed)


def save_builder(builder: Builder, folder: Path) -> Path:
    """Write ``NAME.safetensors`` and ``NAME.json`` into ``folder``; the path of the weights."""
    return _FILES.save(builder, folder)


def builder_files() -> dict[str, Path]:
    """Name and weights of the builders that come with the package."""
    return {file.stem: file for file in sorted(FOLDER.glob("*.safetensors"))}


def is_builder(name_or_path: str) -> bool:
    """Whether a name or a ``.safetensors`` file is a builder's, and no other agent's."""
    path = _FILES.path(name_or_path)
    info = path.with_suffix(".json")
    if not info.is_file():
        return False
    return f'"{_FILES.form}"' in info.read_text(encoding="utf-8", errors="replace")


def load_builder(name_or_path: str | Path = DEFAULT) -> Builder:
    """A builder of the package by name, or one from a ``.safetensors`` file.

    Raises:
        InputError: for files that do not exist, are damaged, or are no builder's.
    """
    return Builder(*_FILES.load(name_or_path))
