"""The page *Learning curves* is made when the documents are built, from the logs of trainings."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from l2a_lab.curves import FIGURES, costs_told, load_curves
from l2a_lab.drawing import write_curves

RUNS = Path(__file__).resolve().parents[1] / "results" / "runs.jsonl.gz"
TEXT = """# Learning curves

Returns of the latest 300 training episodes, exploration included: the mean over agents and the
range from the lowest to the highest, smoothed. The paper shows such curves of architectures,
connectivity and algorithms (appendix figures 3 and 5), and none with a robot. The tables say when
agents first came to the paper's returns, as medians over agents; one that never did counts as
never.
"""


def page() -> str:
    """The page, whose pictures are ``curves/NAME.png``."""
    told = [TEXT]
    for figure in FIGURES.values():
        table = "\n".join(costs_told([figure], RUNS))
        note = f"{figure.note}\n\n" if figure.note else ""
        picture = f"![{figure.title}](curves/{figure.name}.png)"
        told.append(f"## {figure.title}\n\n{picture}\n\n{note}{table}\n")
    return "\n".join(told)


def picture(name: str) -> bytes:
    """The PNG of a figure."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "curves.png"
        write_curves(FIGURES[name].title, load_curves(FIGURES[name], RUNS), "", path)
        return path.read_bytes()


def on_files(files: Any, config: Any) -> Any:
    """Hook of mkdocs."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, "curves.md", content=page()))
    for name in FIGURES:
        files.append(File.generated(config, f"curves/{name}.png", content=picture(name)))
    return files
