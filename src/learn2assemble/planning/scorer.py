"""Small networks that score the candidates of a search: their layers, and their files.

Two hidden layers look at every candidate by itself, together with a summary of the whole. The same
functions take NumPy arrays, with which a search plays, and PyTorch tensors, with which it learns.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from learn2assemble.errors import InputError, check_name
from learn2assemble.files import check_exists, mapping, read_json, write_file

Shapes = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class Scorer:
    """Weights and their origin."""

    name: str
    weights: dict[str, np.ndarray]
    """float32, by name."""
    origin: dict[str, Any] = field(default_factory=dict)
    """Configuration of the training, seed, samples, seconds, commit, hardware."""


def two_layers(weights: Any, candidates: Any, summary: Any) -> Any:
    """What the second layer says of every candidate [..., m, width].

    Args:
        weights: arrays by name, or tensors.
        candidates: [..., m, features].
        summary: [..., 1, features of the whole].
    """
    w = weights
    hidden = candidates @ w["first"] + summary @ w["whole"] + w["first_bias"]
    hidden = hidden * (hidden > 0)
    hidden = hidden @ w["second"] + w["second_bias"]
    return hidden * (hidden > 0)


def layer_shapes(features: int, summary: int, hidden: int, width: int) -> dict[str, Any]:
    """Shapes of the weights of the two layers and of a score."""
    return {
        "first": (features, hidden), "whole": (summary, hidden), "first_bias": (hidden,),
        "second": (hidden, width), "second_bias": (width,), "score": (width, 1),
    }  # fmt: skip


def random_weights(shapes: Shapes, seed: int) -> dict[str, np.ndarray]:
    """float32 weights: biases are 0, what gives a single number begins small."""
    rng = np.random.default_rng(seed)

    def matrix(rows: int, columns: int) -> np.ndarray:
        scale = 0.3 if columns == 1 else 1.4
        return (rng.normal(size=(rows, columns)) * scale / np.sqrt(rows)).astype(np.float32)

    return {
        name: matrix(*shape) if len(shape) == 2 else np.zeros(shape, np.float32)
        for name, shape in shapes.items()
    }


def check_file_name(name: str) -> None:
    """Refuse a name that a file cannot have.

    Raises:
        InputError: naming it.
    """
    if Path(name).name != name or name != name.strip() or not name:
        raise InputError("name", name, "the name of a file, without a folder")


class ScorerFiles(NamedTuple):
    """How scorers of one kind are kept: ``NAME.safetensors`` and ``NAME.json``."""

    form: str
    """The format that the JSON names."""
    words: str
    """What messages call one."""
    folder: Path
    """Of those that come with the package."""
    shapes: Callable[[int, int], Shapes]
    """Of the weights, from the widths of both layers."""

    def path(self, name_or_path: str | Path) -> Path:
        """The weights of a scorer of the package by name, or the file that is named."""
        path = Path(name_or_path)
        return path if path.suffix == ".safetensors" else self.folder / f"{path}.safetensors"

    def save(self, scorer: Scorer, folder: Path) -> Path:
        """Write both files into ``folder``; the path of the weights."""
        from safetensors.numpy import save

        weights = folder / f"{scorer.name}.safetensors"
        content = save({k: np.ascontiguousarray(v) for k, v in scorer.weights.items()})
        write_file(weights, content, "agent")
        info = {"format": self.form, "version": 1, "name": scorer.name, "origin": scorer.origin}
        write_file(weights.with_suffix(".json"), json.dumps(info, indent=1) + "\n", "agent")
        return weights

    def load(self, name_or_path: str | Path) -> tuple[str, dict[str, np.ndarray], dict[str, Any]]:
        """Name, weights and origin of a scorer.

        Raises:
            InputError: for files that do not exist, are damaged, or are of another kind.
        """
        from safetensors import SafetensorError
        from safetensors.numpy import load_file

        path = self.path(name_or_path)
        if path != Path(name_or_path):
            names = [file.stem for file in self.folder.glob("*.safetensors")]
            check_name(self.words, str(name_or_path), names)
        info_file = path.with_suffix(".json")
        for file in (path, info_file):
            check_exists(file, f"file of a {self.words}")
        info = mapping(read_json(info_file, "agent")[0], "agent")
        try:
            if info["format"] != self.form:
                raise ValueError(f"format {info['format']!r}")
            weights = load_file(path)
            widths = len(weights["first_bias"]), len(weights["second_bias"])
            for name, expected in self.shapes(*widths).items():
                given = weights[name]
                if given.shape != expected or not np.isfinite(given).all():
                    raise ValueError(f"{name} has the shape {list(given.shape)} or is not finite")
            return info["name"], weights, info.get("origin", {})
        except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())[:120]
            raise InputError("agent", str(path), f"a {self.words} ({reason})") from None
