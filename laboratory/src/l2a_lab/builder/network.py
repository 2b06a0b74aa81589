"""The network that scores the candidates of the builder of designs, and its files.

Two hidden layers look at every candidate by itself, together with a summary of the whole. The same
functions take NumPy arrays, with which a search plays, and PyTorch tensors, with which it learns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, check_name, extra
from learn2assemble.files import check_exists, write_file
from learn2assemble.planning.tiling.world import LatticeWorld
from learn2assemble.tasks.design_features import NUM_FEATURES, NUM_SUMMARY, describe
from learn2assemble.tasks.networks.agent_file import described, read_description

FORMAT = "learn2assemble-builder"
FOLDER = Path(__file__).parents[4] / "agents" / "builders"
"""The builders of a checkout; the laboratory is in no other place."""
DEFAULT = "builder-s0"
"""The agent that builds where none is named."""
MAX_LOGIT = 30.0


@dataclass(frozen=True, eq=False)
class Builder:
    """Weights of a builder and their origin."""

    name: str
    weights: dict[str, np.ndarray]
    """float32, by name."""
    origin: dict[str, Any] = field(default_factory=dict[str, Any])
    """Configuration of the training, seed, samples, seconds, commit, hardware."""

    def scores(self, candidates: np.ndarray, summary: np.ndarray) -> np.ndarray:
        """Logits of candidates.

        Args:
            candidates: float32[m, NUM_FEATURES].
            summary: float32[NUM_SUMMARY].
        """
        return forward(self.weights, candidates, summary[None])

    def __call__(self, world: LatticeWorld, candidates: np.ndarray) -> np.ndarray:
        """Logits of candidates of a design that is being built (:data:`~.search.Score`)."""
        return self.scores(*describe(world, candidates))


def forward(weights: Any, candidates: Any, summary: Any) -> Any:
    """Logits of candidates [..., m].

    Args:
        weights: arrays by name, or tensors.
        candidates: [..., m, features].
        summary: [..., 1, features of the whole].
    """
    w = weights
    hidden = candidates @ w["first"] + summary @ w["whole"] + w["first_bias"]
    hidden = hidden * (hidden > 0)
    hidden = hidden @ w["second"] + w["second_bias"]
    hidden = hidden * (hidden > 0)
    return (hidden @ w["score"] + w["score_bias"]).clip(-MAX_LOGIT, MAX_LOGIT)[..., 0]


def _shapes(hidden: int, width: int) -> Mapping[str, tuple[int, ...]]:
    return {
        "first": (NUM_FEATURES, hidden),
        "whole": (NUM_SUMMARY, hidden),
        "first_bias": (hidden,),
        "second": (hidden, width),
        "second_bias": (width,),
        "score": (width, 1),
        "score_bias": (1,),
    }


def initial_weights(seed: int, hidden: int = 128, width: int = 64) -> dict[str, np.ndarray]:
    """Random float32 weights: biases are 0, scores begin small.

    Args:
        hidden, width: of the first and of the second layer.
    """
    rng = np.random.default_rng(seed)

    def matrix(rows: int, columns: int) -> np.ndarray:
        scale = 0.3 if columns == 1 else 1.4
        return (rng.normal(size=(rows, columns)) * scale / np.sqrt(rows)).astype(np.float32)

    return {
        name: matrix(*shape) if len(shape) == 2 else np.zeros(shape, np.float32)
        for name, shape in _shapes(hidden, width).items()
    }


def check_file_name(name: str) -> None:
    """Refuse a name that a file cannot have.

    Raises:
        InputError: naming it.
    """
    if Path(name).name != name or name != name.strip() or not name:
        raise InputError("name", name, "the name of a file, without a folder")


def save_builder(builder: Builder, folder: Path) -> Path:
    """Write ``NAME.safetensors`` into ``folder``; its path."""
    with extra("safetensors", "learn"):
        from safetensors.numpy import save

    weights = folder / f"{builder.name}.safetensors"
    info = {"format": FORMAT, "version": 1, "name": builder.name, "origin": builder.origin}
    tensors = {k: np.ascontiguousarray(v) for k, v in builder.weights.items()}
    write_file(weights, save(tensors, described(info)), "agent")
    return weights


def builder_files() -> dict[str, Path]:
    """Name and weights of the builders that stand for all in tables and commands: of seed 0."""
    return {file.stem: file for file in sorted(FOLDER.glob("*-s0.safetensors"))}


def is_builder(name_or_path: str) -> bool:
    """Whether a name or a ``.safetensors`` file is a builder's, and no other agent's."""
    try:
        return read_description(_weights(name_or_path)).get("format") == FORMAT
    except InputError:
        return False


def load_builder(name_or_path: str | Path = DEFAULT) -> Builder:
    """A builder by its name, or one from a ``.safetensors`` file.

    Raises:
        InputError: for files that do not exist, are damaged, or are no builder's.
    """
    with extra("safetensors", "learn"):
        from safetensors import SafetensorError
        from safetensors.numpy import load_file  # pyright: ignore[reportUnknownVariableType]

    path = _weights(name_or_path)
    if path != Path(name_or_path) and not path.is_file():
        check_name("builder of designs", str(name_or_path), builder_files())
    check_exists(path, "file of a builder of designs")
    info = read_description(path)
    try:
        if info["format"] != FORMAT:
            raise ValueError(f"format {info['format']!r}")
        weights = load_file(path)
        widths = len(weights["first_bias"]), len(weights["second_bias"])
        for name, expected in _shapes(*widths).items():
            given = weights[name]
            if given.shape != expected or not np.isfinite(given).all():
                raise ValueError(f"{name} has the shape {list(given.shape)} or is not finite")
        return Builder(info["name"], weights, info.get("origin", {}))
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError("agent", str(path), f"a builder of designs ({reason})") from None


def _weights(name_or_path: str | Path) -> Path:
    """The weights of a builder by its name, or the file that is named."""
    path = Path(name_or_path)
    return path if path.suffix == ".safetensors" else FOLDER / f"{path}.safetensors"
