"""The network that guides the search: how likely each child is on the way to a structure.

Two layers look at every candidate beside a summary of the state. A third, over what the likely ones
look like, tells the blocks that will be needed beyond the relaxed plan: an auxiliary task of the
training, which the search does not ask for. One function does it for NumPy arrays, with which the
search plays, and for PyTorch tensors, with which it learns.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.files import mapping, read_json, write_file
from learn2assemble.planning.goals.features import NUM_FEATURES, NUM_SUMMARY

FORMAT = "learn2assemble-goals-guide"
FOLDER = Path(__file__).parents[2] / "assets" / "goals"
DEFAULT = "goals-s0"
"""The guide that comes with the package."""
HIDDEN, WIDTH = 96, 64


@dataclass(frozen=True, eq=False)
class Guide:
    """Weights and their origin."""

    name: str
    weights: dict[str, np.ndarray]
    """float32, by name."""
    origin: dict[str, Any] = field(default_factory=dict)
    """Configuration of the training, its length and figures, commit, hardware."""

    def scores(self, candidates: np.ndarray, summary: np.ndarray) -> np.ndarray:
        """float32[m]: logits of candidates.

        Args:
            candidates: float32[m, NUM_FEATURES], m at least 1.
            summary: float32[NUM_SUMMARY].
        """
        return forward(self.weights, candidates, summary[None], np.zeros(len(candidates)))[0]


def forward(weights: Any, candidates: Any, summary: Any, padding: Any) -> tuple[Any, Any]:
    """Logits of candidates [..., m], and blocks beyond the relaxed plan [...].

    Args:
        weights: arrays by name, or tensors.
        candidates: [..., m, NUM_FEATURES].
        summary: [..., 1, NUM_SUMMARY].
        padding: [..., m], 0 for a candidate and a large negative number for none.
    """
    w = weights
    hidden = candidates @ w["first"] + summary @ w["whole"] + w["first_bias"]
    hidden = hidden * (hidden > 0)
    hidden = hidden @ w["second"] + w["second_bias"]
    hidden = hidden * (hidden > 0)
    logits = (hidden @ w["score"])[..., 0] + padding
    # A softmax whose logits are bounded: the mean of what the likely candidates look like.
    likely = 2.718281828 ** logits.clip(-30, 30)
    likely = likely / likely.sum(-1)[..., None]
    seen = (hidden * likely[..., None]).sum(-2)
    value = seen @ w["likely"] + summary[..., 0, :] @ w["state"] + w["value_bias"]
    value = value * (value > 0)
    return logits, (value @ w["value"])[..., 0] + w["final_bias"][0]


def initial_weights(seed: int, hidden: int = HIDDEN, width: int = WIDTH) -> dict[str, np.ndarray]:
    """Random weights."""
    rng = np.random.default_rng(seed)

    def matrix(rows: int, columns: int, scale: float = 1.4) -> np.ndarray:
        return (rng.normal(size=(rows, columns)) * scale / np.sqrt(rows)).astype(np.float32)

    return {
        "first": matrix(NUM_FEATURES, hidden), "whole": matrix(NUM_SUMMARY, hidden),
        "first_bias": np.zeros(hidden, np.float32), "second": matrix(hidden, width),
        "second_bias": np.zeros(width, np.float32), "score": matrix(width, 1, 0.3),
        "likely": matrix(width, width), "state": matrix(NUM_SUMMARY, width),
        "value_bias": np.zeros(width, np.float32), "value": matrix(width, 1, 0.3),
        "final_bias": np.zeros(1, np.float32),
    }  # fmt: skip


# ---------------------------------------------------------------- files


def save_guide(guide: Guide, folder: Path) -> Path:
    """Write ``NAME.safetensors`` and ``NAME.json`` into ``folder``; the path of the weights."""
    from safetensors.numpy import save

    weights = folder / f"{guide.name}.safetensors"
    content = save({k: np.ascontiguousarray(v) for k, v in guide.weights.items()})
    write_file(weights, content, "agent")
    info = {"format": FORMAT, "version": 1, "name": guide.name, "origin": guide.origin}
    write_file(weights.with_suffix(".json"), json.dumps(info, indent=1) + "\n", "agent")
    return weights


@cache
def load_guide(name_or_path: str = DEFAULT) -> Guide:
    """A guide of the package by name, or one from a ``.safetensors`` file.

    Raises:
        InputError: for files that do not exist, are damaged, or are no guide's.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    path = Path(name_or_path)
    if path.suffix != ".safetensors":
        path = FOLDER / f"{name_or_path}.safetensors"
    info_file = path.with_suffix(".json")
    if not (path.is_file() and info_file.is_file()):
        raise InputError("agent", name_or_path, "an existing guide of goals")
    info = mapping(read_json(info_file, "agent")[0], "agent")
    try:
        if info["format"] != FORMAT:
            raise ValueError(f"format {info['format']!r}")
        weights = load_file(path)
        sizes = len(weights["first_bias"]), len(weights["second_bias"])
        for name, expected in initial_weights(0, *sizes).items():
            if weights[name].shape != expected.shape or not np.isfinite(weights[name]).all():
                raise ValueError(f"{name} has another shape or is not finite")
        return Guide(info["name"], weights, info.get("origin", {}))
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError("agent", str(path), f"a guide of goals ({reason})") from None


def default_guide() -> Guide | None:
    """The guide of the package; None where it has none."""
    return load_guide() if (FOLDER / f"{DEFAULT}.safetensors").is_file() else None
