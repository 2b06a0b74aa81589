"""The page *Tables* and its figures are results, not documents: this hook of mkdocs adds them to
the site."""

from __future__ import annotations

from pathlib import Path
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


def on_files(files: Any, config: Any) -> Any:
    """Hook of mkdocs: ``tables.md``, whose links lead to documents, and ``tables.csv``."""
    from mkdocs.structure.files import File

    text = (RESULTS / "tables.md").read_text(encoding="utf-8").replace("](../docs/", "](")
    for colour, (name, mark) in MARKS.items():
        text = text.replace(colour, f'<span class="{name}" title="{name}">{mark}</span>')
    files.append(File.generated(config, "tables.md", content=HEAD + text))
    figures = (RESULTS / "tables.csv").read_text(encoding="utf-8")
    files.append(File.generated(config, "tables.csv", content=figures))
    return files
