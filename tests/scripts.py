"""Scripts of the repository, run as a user runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def run_script(script: Path, *words: str, cwd: Path) -> str:
    """What a script prints that ends well."""
    done = subprocess.run(
        [sys.executable, str(script), *words],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout
