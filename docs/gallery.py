"""The page *Gallery*: pictures of builds, each made from its command when the documents are built.

``python docs/gallery.py [NAME ...]`` makes pictures (all of them without names), into
``out/gallery``; those that are newer than their command and the source are left alone. Mkdocs loads
this file as a hook, makes them, and adds them and the page to the site. ``python docs/gallery.py
--film PLAN.mp4 FILM.gif`` makes a small moving picture of a video.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / "docs" / "gallery.toml"
FOLDER = ROOT / "out" / "gallery"
AT_ONCE = 2
"""Builds at one time."""
LIMIT = 300.0
"""Longest build [s]."""
MOMENT = 0.6
"""Where an arm built, the share of the build after which it is shown."""
FILM = {"width": 480, "every": 10, "colours": 48, "milliseconds": 90}
"""Of a moving picture: width [px], every which frame of the video, colours, time of a frame."""


class Entry(NamedTuple):
    """One build."""

    name: str
    title: str
    text: str
    command: str
    """``OUT`` stands for the folder it writes."""
    turn: float = 0.0
    """So far the structure is turned in its picture [deg]."""

    @property
    def shown(self) -> str:
        """The command as a reader would type it."""
        return self.command.replace("OUT", f"out/{self.name}")

    @property
    def folder(self) -> Path:
        """What the command writes."""
        return FOLDER / self.name

    @property
    def picture(self) -> Path:
        """Of the finished structure."""
        return FOLDER / f"{self.name}.png"

    @property
    def told(self) -> Path:
        """The command, seconds and number of blocks."""
        return FOLDER / f"{self.name}.json"

    def facts(self) -> dict[str, Any]:
        """See :attr:`told`; empty where the picture has to be made anew."""
        if not (self.picture.is_file() and self.told.is_file()):
            return {}
        facts = json.loads(self.told.read_text(encoding="utf-8"))
        sources = [*(ROOT / "src").rglob("*.py"), *(ROOT / "examples").rglob("*")]
        newest = max(file.stat().st_mtime for file in sources)
        current = facts["command"] == self.command and self.picture.stat().st_mtime > newest
        return facts if current else {}


def entries() -> list[Entry]:
    """What ``gallery.toml`` lists."""
    return [Entry(**one) for one in tomllib.loads(LIST.read_text(encoding="utf-8"))["build"]]


def is_empty(picture: Path) -> bool:
    """Whether a picture has no more than a floor, its shadows and a title."""
    from PIL import Image

    with Image.open(picture) as image:
        colourful = np.ptp(np.asarray(image.convert("RGB"), int), axis=-1) > 40
    return bool(colourful.mean() < 0.01)


def make(entry: Entry) -> dict[str, Any]:
    """Carry the command out, and draw what it built.

    Raises:
        RuntimeError: where the command fails or builds nothing, or the picture shows nothing.
    """
    import shutil

    from PIL import Image

    import learn2assemble as l2a
    from learn2assemble.viewer.picture import write_progress
    from learn2assemble.viewer.video import Frames

    facts = entry.facts()
    if facts:
        return facts
    shutil.rmtree(entry.folder, ignore_errors=True)
    FOLDER.mkdir(parents=True, exist_ok=True)
    program, *words = shlex.split(entry.command.replace("OUT", str(entry.folder)))
    start = [sys.executable] if program == "python" else [sys.executable, "-m", "learn2assemble"]
    began = time.monotonic()
    done = subprocess.run(
        [*start, *words], cwd=ROOT, capture_output=True, text=True, timeout=LIMIT, check=False
    )
    seconds = round(time.monotonic() - began, 1)
    if done.returncode or not (entry.folder / "plan.json").is_file():
        raise RuntimeError(f"gallery, {entry.name}: {entry.command}\n{done.stderr[-2000:]}")
    plan = l2a.load_plan(entry.folder)
    if plan.records:
        cell = Frames(plan, plan.records)
        Image.fromarray(cell.picture(MOMENT * cell.playback.duration)).save(entry.picture)
    else:
        write_progress(plan, entry.picture, moments=1, turn=entry.turn, title=False)
    if is_empty(entry.picture):
        raise RuntimeError(f"gallery, {entry.name}: the picture shows nothing")
    blocks = 0 if plan.assembly is None else len(plan.assembly.blocks)
    arm = " and ".join(record.arm.name for record in plan.records)
    facts = {"command": entry.command, "seconds": seconds, "blocks": blocks, "arm": arm}
    entry.told.write_text(json.dumps(facts), encoding="utf-8")
    return facts


def make_all(names: list[str] | None = None) -> dict[str, dict[str, Any]]:
    """Facts of the entries with these names; of all."""
    chosen = [one for one in entries() if not names or one.name in names]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return dict(zip((one.name for one in chosen), pool.map(make, chosen), strict=True))


def page(facts: dict[str, dict[str, Any]]) -> str:
    """The page as Markdown."""
    lines = [
        "# Gallery",
        "",
        "Every picture was made by the command under it when these documents were built; seconds "
        "include the start of the program, the proof and the pages, on the machine that built "
        "them, two builds at a time; where something had to be compiled first, as after a new "
        "installation, that is in them too.",
    ]
    for one in entries():
        told = facts[one.name]
        arm = f", built by {told['arm']}" if told["arm"] else ""
        lines += [
            f"\n## {one.title}",
            f"\n![{one.title}](gallery/{one.name}.png){{ width=420 }}",
            f"\n{one.text} {told['blocks']} blocks, {told['seconds']:.0f} s{arm}.",
            f"\n```sh\n{one.shown}\n```",
        ]
    return "\n".join(lines) + "\n"


def film(video: Path, out: Path) -> None:
    """A small moving picture of a video."""
    import av
    from PIL import Image

    frames = []
    with av.open(str(video)) as container:
        for number, frame in enumerate(container.decode(video=0)):
            if number % FILM["every"] == 0:
                image = frame.to_image()
                size = FILM["width"], round(image.height * FILM["width"] / image.width)
                frames.append(image.resize(size, Image.Resampling.LANCZOS))
    palette = frames[len(frames) * 2 // 3].quantize(FILM["colours"])
    few = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in frames]
    few[0].save(out, save_all=True, append_images=few[1:], duration=FILM["milliseconds"], loop=0)


def on_files(files: Any, config: Any) -> Any:
    """Hook of mkdocs: the page and its pictures are files of the site."""
    from mkdocs.structure.files import File

    facts = make_all()
    files.append(File.generated(config, "gallery.md", content=page(facts)))
    for one in entries():
        path = f"gallery/{one.name}.png"
        files.append(File.generated(config, path, content=one.picture.read_bytes()))
    return files


if __name__ == "__main__":
    if sys.argv[1:2] == ["--film"]:
        film(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        for name, told in make_all(sys.argv[1:]).items():
            sys.stdout.write(f"{name}: {told}\n")
