"""The pages *Tables* and *Learning curves* are results, not documents: this hook of mkdocs adds
them and their figures to the site."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

RESULTS = Path(__file__).resolve().parents[1] / "results"
HEAD = """---
hide: [navigation]
---
<style>
.md-typeset table:not([class]) :is(td, th) { padding: .35em .7em; min-width: 0; }
.md-typeset table:not([class]) :is(td, th):not(:first-child) { white-space: nowrap; }
.better { color: #2b8a3e; } .level { color: #e67700; } .worse { color: #c92a2a; }
</style>

"""
MARKS = {"🟢": ("better", "▲"), "🟡": ("level", "="), "🔴": ("worse", "▼")}
"""Colours that a forge shows as they are; not every browser has letters for them."""

CURVES = """# Learning curves

Returns of the latest 300 training episodes, exploration included: the mean over agents and the
range from the lowest to the highest, smoothed. The paper shows such curves of architectures,
connectivity and algorithms (appendix figures 3 and 5), and none with a robot. The tables say when
agents first came to the paper's returns, as medians over agents; one that never did counts as
never.
"""

CONDITION = re.compile(
    r'^<details markdown="1"(?P<open> open)?><summary>(?P<label>[^\n]*)</summary>\n'
    r"(?P<table>.*?)^</details>\n\s*",
    re.MULTILINE | re.DOTALL,
)
"""A condition of a table: a forge shows it as a fold-out."""


def tabs(text: str) -> str:
    """The fold-outs of a page that follow one another, as tabs of which one is seen.

    Args:
        text: a page as a forge shows it.

    Returns:
        The page with ``=== "label"`` of pymdownx.tabbed (``===+`` where one is open) in place of
        fold-outs. One that stands alone stays: there is nothing to choose.
    """
    runs: list[list[re.Match[str]]] = []
    for one in CONDITION.finditer(text):
        if runs and runs[-1][-1].end() == one.start():
            runs[-1].append(one)
        else:
            runs.append([one])
    out, done = [], 0
    for run in runs:
        if len(run) > 1:
            out += [text[done : run[0].start()], *map(_tab, run)]
            done = run[-1].end()
    return "".join([*out, text[done:]])


def _tab(one: re.Match[str]) -> str:
    lines = one["table"].strip().splitlines()
    shown = "\n".join(f"    {line}" if line else "" for line in lines)
    return f'==={"+" if one["open"] else ""} "{one["label"]}"\n\n{shown}\n\n'


def curves_page() -> str:
    """The page of learning curves, whose pictures are ``curves/NAME.png``."""
    from l2a_lab.curves import FIGURES, costs_told

    told = [CURVES]
    for figure in FIGURES.values():
        table = "\n".join(costs_told([figure], RESULTS / "runs.jsonl.gz"))
        note = f"{figure.note}\n\n" if figure.note else ""
        picture = f"![{figure.title}](curves/{figure.name}.png)"
        told.append(f"## {figure.title}\n\n{picture}\n\n{note}{table}\n")
    return "\n".join(told)


def curves_picture(name: str) -> bytes:
    """The PNG of a figure of learning curves."""
    from l2a_lab.curves import FIGURES, load_curves
    from l2a_lab.drawing import write_curves

    figure, runs = FIGURES[name], RESULTS / "runs.jsonl.gz"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "curves.png"
        write_curves(figure.title, load_curves(figure, runs), "", path)
        return path.read_bytes()


def on_files(files: Any, config: Any) -> Any:
    """Hook of mkdocs: ``tables.md``, whose links lead to documents, its CSV, and ``curves.md``."""
    from mkdocs.structure.files import File

    from l2a_lab.curves import FIGURES

    text = (RESULTS / "tables.md").read_text(encoding="utf-8").replace("](../docs/", "](")
    for colour, (name, mark) in MARKS.items():
        text = text.replace(colour, f'<span class="{name}" title="{name}">{mark}</span>')
    files.append(File.generated(config, "tables.md", content=HEAD + tabs(text)))
    figures = (RESULTS / "tables.csv").read_text(encoding="utf-8")
    files.append(File.generated(config, "tables.csv", content=figures))
    files.append(File.generated(config, "curves.md", content=curves_page()))
    for name in FIGURES:
        path = f"curves/{name}.png"
        files.append(File.generated(config, path, content=curves_picture(name)))
    return files
