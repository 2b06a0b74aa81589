"""Programs that tests start: a headless browser that opens pages without a network, with what its
pictures show, and scripts of the repository, run as a user runs them; and files as trees of syntax.
"""

from __future__ import annotations

import ast
import io
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAT = ("--disable-gpu", "--disable-3d-apis")
SPATIAL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def find_browser() -> str:
    """The browser's program; skips the test where there is none."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no headless browser on PATH (looked for {', '.join(BROWSERS)})")
    return found


def browse(browser: str, folder: Path, address: str, *options: str) -> tuple[str, str]:
    """Open a page without a network; standard output and the browser's log."""
    folder.mkdir()
    command = [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--hide-scrollbars",
        "--enable-logging=stderr",
        f"--user-data-dir={folder / 'profile'}",
        "--virtual-time-budget=4000",
        *options,
        address,
    ]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env={**os.environ, "HOME": str(folder)},
    )
    return done.stdout, done.stderr


def _side_by_side(folder: Path, anchors: tuple[str, ...], size: tuple[int, int]) -> str:
    """A page that shows the report at several anchors, so that one browser run sees them all.

    An anchor may be of another page, ``PATH#ANCHOR``.
    """
    pages = [anchor if "#" in anchor else f"view.html#{anchor}" for anchor in anchors]
    frames = "".join(
        f'<iframe src="{page}" style="border:0;width:{size[0]}px;'
        f'height:{size[1]}px;position:absolute;top:0;left:{index * size[0]}px"></iframe>'
        for index, page in enumerate(pages)
    )
    (folder / "frames.html").write_text(f"<!doctype html><body>{frames}", encoding="utf-8")
    return (folder / "frames.html").as_uri()


def shoot(
    browser: str, folder: Path, anchors: tuple[str, ...], size: tuple[int, int], *options: str
) -> tuple[list[np.ndarray], str]:
    """The picture of ``view.html`` in ``folder`` at every anchor, and the browser's log.

    An anchor may be of another page, ``PATH#ANCHOR``.
    """
    shot = folder / "shot.png"
    _, log = browse(
        browser,
        folder / "run",
        _side_by_side(folder, anchors, size),
        *options,
        f"--screenshot={shot}",
        f"--window-size={size[0] * len(anchors)},{size[1]}",
    )
    assert shot.is_file(), log
    image = read_picture(shot)
    return [image[:, k * size[0] : (k + 1) * size[0]] for k in range(len(anchors))], log


def read_picture(file: Path) -> np.ndarray:
    """Its colours, float64[rows, columns, channels], from 0 to 1."""
    with Image.open(file) as picture:
        return np.asarray(picture) / 255


def pixels(image: np.ndarray, colour: str) -> int:
    """Pixels within two levels of a colour."""
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)])
    return int((np.abs(np.rint(255 * image[..., :3]) - wanted) <= 2).all(-1).sum())


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


class Terminal(io.StringIO):
    """Keeps what is written to it, as a terminal would show it."""

    def isatty(self) -> bool:
        return True


@cache
def tree_of(path: Path) -> ast.Module:
    """The syntax of a file of the project, read once for all tests of a process."""
    return ast.parse(path.read_text(encoding="utf-8"))
