"""The wheel carries everything a build needs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.slow
def test_the_wheel_builds_a_design_elsewhere(tmp_path: Path) -> None:
    """Built, unpacked in another place, run from a third: nothing of the checkout is used."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(tmp_path)]
    subprocess.run([*command, str(ROOT)], check=True, capture_output=True, timeout=300)
    (wheel,) = tmp_path.glob("learn2assemble-*.whl")
    assert wheel.stat().st_size <= 4_000_000
    installed = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(installed)
        names = set(archive.namelist())
    for arm in ("panda", "ur5e"):
        folder = f"learn2assemble/assets/arms/{arm}"
        wanted = {f"{folder}/{name}" for name in ("arm.toml", f"{arm}.xml", "LICENSE", "NOTICE")}
        assert wanted <= names
        assert f"{folder}/meshes.zip" in names
    tower = [[-0.025, 0.0], [-0.025, 0.1], [0.025, 0.1], [0.025, 0.0]]
    design = tmp_path / "tower.json"
    design.write_text(
        json.dumps(
            {
                "format": "learn2assemble-design",
                "version": 1,
                "kit": "cubes",
                "elevations": [{"name": "front", "outline": tower}],
            }
        )
    )
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "learn2assemble",
            "build",
            str(design),
            "--out",
            "out",
            "--json",
            "--seconds",
            "200",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
        # In a new place all kernels would be compiled again, for longer than they run as Python.
        env={**os.environ, "PYTHONPATH": str(installed), "NUMBA_DISABLE_JIT": "1"},
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["status"] == "complete"
    for name in ("plan.json", "view.html", "progress.png"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    absent = subprocess.run(
        [sys.executable, "-m", "learn2assemble", "eval", "bars-one-sided-5x5-25-27"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(installed)},
    )
    assert absent.returncode == 2
    (line,) = absent.stderr.splitlines()
    assert "relational-bars-s0" in line
    assert "to fetch it (fetch_agents)" in line
    where = subprocess.run(
        [sys.executable, "-c", "import learn2assemble; print(learn2assemble.__file__)"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(installed)},
    )
    assert str(installed) in where.stdout
