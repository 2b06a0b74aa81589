"""The network that scores candidates.

Two hidden layers look at every candidate by itself, together with the summary of the whole. One
function does it for NumPy arrays, with which the agent plays, and for PyTorch tensors, with which
it learns.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.files import mapping, read_json, write_file
from learn2assemble.planning.agent.features import NUM_FEATURES, NUM_SUMMARY

FORMAT = "learn2assemble-builder"
FOLDER = Path(__file__).parents[2] / "assets" / "builders"
"""The builders that come with the package."""
DEFAULT = "builder-s0"
"""The agent that builds where none is named."""


@dataclass(frozen=True, eq=False)
class Builder:
    """Weights and their origin."""

    name: str
    weights: dict[str, np.ndarray]
    """float32, by name."""
    origin: dict[str, Any] = field(default_factory=dict)
    """Configuration of the training, seed, samples, seconds, commit, hardware."""

    def scores(self, candidates: np.ndarray, summary: np.ndarray) -> np.ndarray:
        """Logits of candidates.

        Args:
            candidates: float32[m, NUM_FEATURES].
            summary: float32[NUM_SUMMARY].
        """
        return forward(self.weights, candidates, summary[None])


def forward(weights: Any, candidates: Any, summary: Any) -> Any:
    """Logits of candidates [..., m].

    Args:
        weights: arrays by name, or tensors.
        candidates: [..., m, NUM_FEATURES].
        summary: [..., 1, NUM_SUMMARY].
    """
    w = weights
    hidden = candidates @ w["first"] + summary @ w["whole"] + w["first_bias"]
    hidden = hidden * (hidden > 0)
    hidden = hidden @ w["second"] + w["second_bias"]
    hidden = hidden * (hidden > 0)
    return (hidden @ w["score"] + w["score_bias"]).clip(-30, 30)[..., 0]


def initial_weights(seed: int, hidden: int = 128, width: int = 64) -> dict[str, np.ndarray]:
    """Random weights.

    Args:
        hidden, width: of the first and of the second layer.
    """
    rng = np.random.default_rng(seed)

    def matrix(rows: int, columns: int, scale: float = 1.4) -> np.ndarray:
        return (rng.normal(size=(rows, columns)) * scale / np.sqrt(rows)).astype(np.float32)

    return {
        "first": matrix(NUM_FEATURES, hidden),
        "whole": matrix(NUM_SUMMARY, hidden),
        "first_bias": np.zeros(hidden, np.float32),
        "second": matrix(hidden, width),
        "second_bias": np.zeros(width, np.float32),
        "score": matrix(width, 1, 0.3),
        "score_bias": np.zeros(1, np.float32),
    }


# ---------------------------------------------------------------- files


def save_builder(builder: Builder, folder: Path) -> Path:
    """Write ``NAME.safetensors`` and ``NAME.json`` into ``folder``; the path of the weights."""
    from safetensors.numpy import save_file

    weights = folder / f"{builder.name}.safetensors"
    part = weights.with_suffix(".part")
    try:
        save_file({k: np.ascontiguousarray(v) for k, v in builder.weights.items()}, part)
        os.replace(part, weights)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError("agent", str(weights), f"a place that can be written ({error})") from None
    info = {"format": FORMAT, "version": 1, "name": builder.name, "origin": builder.origin}
    write_file(weights.with_suffix(".json"), json.dumps(info, indent=1) + "\n", "agent")
    return weights


def is_builder(name_or_path: str) -> bool:
    """Whether a name or a ``.safetensors`` file is a builder's, and no other agent's."""
    path = Path(name_or_path)
    if path.suffix != ".safetensors":
        return (FOLDER / f"{name_or_path}.safetensors").is_file()
    info = path.with_suffix(".json")
    return info.is_file() and f'"{FORMAT}"' in info.read_text(encoding="utf-8", errors="replace")


def load_builder(name_or_path: str | Path = DEFAULT) -> Builder:
    """A builder of the package by name, or one from a ``.safetensors`` file.

    Raises:
        InputError: for files that do not exist, are damaged, or are no builder's.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    path = Path(name_or_path)
    if path.suffix != ".safetensors":
        path = FOLDER / f"{name_or_path}.safetensors"
    info_file = path.with_suffix(".json")
    for file in (path, info_file):
        if not file.is_file():
            raise InputError("agent", str(name_or_path), "an existing builder of designs")
    info = mapping(read_json(info_file, "agent")[0], "agent")
    try:
        if info["format"] != FORMAT:
            raise ValueError(f"format {info['format']!r}")
        weights = load_file(path)
        sizes = len(weights["first_bias"]), len(weights["second_bias"])
        for name, expected in initial_weights(0, *sizes).items():
            given = weights[name]
            if given.shape != expected.shape or not np.isfinite(given).all():
                raise ValueError(f"{name} has the shape {list(given.shape)} or is not finite")
        return Builder(info["name"], weights, info.get("origin", {}))
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError("agent", str(path), f"a builder of designs ({reason})") from None
