"""Result files: one per cell, written whole or not at all, with everything needed to repeat it."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError
from learn2assemble.evaluation.cells import Cell
from learn2assemble.networks.agent import PRETRAINED

FORMAT, VERSION = "learn2assemble-cell", 1


@dataclass(frozen=True)
class Result:
    """What a result file says."""

    cell: Cell
    agent_hash: str | None
    data: dict[str, Any]

    @property
    def episodes(self) -> int:
        return int(self.data["episodes"])

    def array(self, name: str) -> np.ndarray:
        """One number an episode: float64[E]."""
        return np.asarray(self.data[name], float)


def write_result(root: Path, cell: Cell, agent_hash: str | None, data: dict[str, Any]) -> Path:
    """Write the file of ``cell`` below ``root``; a kill leaves the old one or the new one.

    Raises:
        InputError: where it cannot be written.
    """
    file = root / cell.path
    head = {
        "format": FORMAT, "version": VERSION, "cell": cell.to_dict(), "agent_hash": agent_hash,
    }  # fmt: skip
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in {**head, **data}.items()]
    part = file.with_suffix(f".{os.getpid()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        part.replace(file)
    except OSError as error:
        raise InputError(
            "--out", str(root), f"a writable folder ({error.strerror or 'unwritable'})"
        ) from None
    return file


def read_result(file: Path) -> Result | None:
    """A result file; ``None`` where it is absent, damaged or of another version."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        if (data.pop("format"), data.pop("version")) != (FORMAT, VERSION):
            return None
        result = Result(Cell.from_dict(data.pop("cell")), data.pop("agent_hash"), data)
        counts = {len(v) for v in data.values() if isinstance(v, list)}
        return result if counts == {result.episodes} else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def is_current(root: Path, cell: Cell, agent_hash: str | None, episodes: int) -> bool:
    """Whether ``cell`` has been measured as it is now, with at least ``episodes`` episodes."""
    result = read_result(root / cell.path)
    return (
        result is not None
        and (result.cell, result.agent_hash) == (cell, agent_hash)
        and result.episodes >= episodes
    )


def measured_agents(root: Path, task: str) -> set[str]:
    """Names of the agents with results on ``task``."""
    found = set()
    for file in (root / "cells" / task).glob("*.json"):
        result = read_result(file)
        if result is not None and result.cell.agent:
            found.add(result.cell.agent)
    return found


def find_agents(folder: Path | None) -> dict[str, Path]:
    """Name and weights of the agents in ``folder``; of the shipped ones without it.

    An agent is ``NAME.safetensors`` or a run folder ``NAME``.

    Raises:
        InputError: where the folder does not exist.
    """
    if folder is None:
        folder = PRETRAINED
    elif not folder.is_dir():
        raise InputError("--agents", str(folder), "an existing folder")
    runs = {f.parent.name: f for f in folder.glob("*/agent.safetensors")}
    files = {f.stem: f for f in folder.glob("*.safetensors")}
    return {name: f for name, f in sorted({**runs, **files}.items()) if _info(f).is_file()}


def agent_hash(weights: Path) -> str:
    """16 hexadecimal digits that change with the weights or the architecture of an agent."""
    try:
        network = json.loads(_info(weights).read_text(encoding="utf-8"))["network"]
        digest = hashlib.sha256(weights.read_bytes())
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("agent", str(weights), "a trained agent") from None
    digest.update(json.dumps(network, sort_keys=True).encode())
    return digest.hexdigest()[:16]


def _info(weights: Path) -> Path:
    return weights.with_suffix(".json")
