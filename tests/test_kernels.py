"""Compiled functions kept on the disk are those of the source as it is now."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GUARDED = "from learn2assemble.kernels import kernel"
BARE = "from numba import njit\nkernel = njit(cache=True)"
CALLEE = """
from typing import NamedTuple
import numpy as np
{kernel}

SHARE = {share}
TABLE = np.array([{share}])

class Pair(NamedTuple):
    {fields}

@kernel
def inner(x):
    return {share} * x
"""
CALLER = """
import callee
from callee import SHARE, TABLE, inner
{kernel}

@kernel
def called(x):
    return below(x)

@kernel
def below(x):
    return inner(x)

@kernel
def number(x):
    return SHARE * x

@kernel
def array(x):
    return TABLE[0] * x

@kernel
def module(x):
    return callee.SHARE * x

@kernel
def field(pair):
    return pair.wide
"""
SCRIPT = """
import json
from caller import *
pair = callee.Pair(wide=3.0, long=5.0)
results = [called(1.0), number(1.0), array(1.0), module(1.0), field(pair)]
kernels = called, number, array, module, field
hits = [sum(kernel.stats.cache_hits.values()) for kernel in kernels]
print(json.dumps([results, sum(hits)]))
"""
OLD, NEW = [2.0, 2.0, 2.0, 2.0, 3.0], [4.0, 4.0, 4.0, 4.0, 3.0]
MIXED = [2.0, 2.0, 2.0, 2.0, 5.0]


def _write(folder: Path, kernel: str, share: float, fields: str) -> None:
    names = "; ".join(f"{name}: float" for name in fields.split())
    callee = CALLEE.format(kernel=kernel, share=share, fields=names)
    for name, text in ("callee", callee), ("caller", CALLER.format(kernel=kernel)):
        file = folder / f"{name}.py"
        # Older versions of numba look at the time of a file, not at what is in it.
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def _run(folder: Path, script: str = SCRIPT) -> tuple[list[float], int]:
    """Results of a process of its own, and how many functions it did not compile."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{folder}"},
    )
    assert done.returncode == 0, done.stderr
    results, hits = json.loads(done.stdout)
    return results, hits


def test_a_change_of_what_is_called_or_read_is_compiled(tmp_path: Path) -> None:
    _write(tmp_path, GUARDED, 2.0, "wide long")
    assert _run(tmp_path) == (OLD, 0)
    assert _run(tmp_path) == (OLD, 5)
    kept = sorted(path.name for path in tmp_path.rglob("*.nb?"))
    assert len(kept) == 14
    _write(tmp_path, "\n" + GUARDED, 4.0, "long wide")
    assert _run(tmp_path) == (NEW, 0)
    # Nothing piles up: the new files have replaced the old ones.
    assert sorted(path.name for path in tmp_path.rglob("*.nb?")) == kept


def test_without_the_guard_old_results_come(tmp_path: Path) -> None:
    """What the guard is for, and that the test above can fail."""
    _write(tmp_path, BARE, 2.0, "wide long")
    assert _run(tmp_path) == (OLD, 0)
    _write(tmp_path, BARE, 4.0, "long wide")
    assert _run(tmp_path) == (MIXED, 5)


def test_a_class_that_was_renamed_is_compiled(tmp_path: Path) -> None:
    """What is kept names the classes of its arguments: a new name is no reason to stop."""
    for name in ("Pair", "Couple"):
        _write(tmp_path, GUARDED, 2.0, "wide long")
        text = (tmp_path / "callee.py").read_text(encoding="utf-8").replace("Pair", name)
        (tmp_path / "callee.py").write_text(text, encoding="utf-8")
        made = _run(tmp_path, SCRIPT.replace("Pair", name))
        assert made[0] == OLD
