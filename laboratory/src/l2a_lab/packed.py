"""Packs: many results in one file, sorted lines of JSON, compressed; ``zcat`` shows one.

What is measured of a cell is written to a file of its own first, ``cells/TASK/NAME``, so that
nothing is lost when a run is killed; :func:`pack` then moves it into the pack of all cells,
``cells.jsonl.gz``, where it is called ``TASK/NAME``. A file of its own that is still there is the
newer one.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from learn2assemble.files import write_file

ENDING = ".jsonl.gz"


def read_document(file: Path) -> str:
    """The text of a result ``cells/TASK/NAME``, of its own file or out of the pack of the cells.

    Raises:
        KeyError: where it is in neither.
        OSError, ValueError: for what cannot be read.
    """
    if file.is_file():
        return file.read_text(encoding="utf-8")
    return read_pack(_pack_of(file.parents[1]))[f"{file.parent.name}/{file.name}"]


def names(cells: Path, task: str = "*") -> list[str]:
    """The results below a folder ``cells`` as ``TASK/NAME``, sorted; packed ones included.

    Args:
        task: of this one only.
    """
    packed = (name for name in read_pack(_pack_of(cells)) if task in ("*", name.split("/")[0]))
    alone = (f"{file.parent.name}/{file.name}" for file in cells.glob(f"{task}/*.json"))
    return sorted({*packed, *alone})


def pack(cells: Path) -> int:
    """Move all results that have files of their own into the pack.

    Args:
        cells: folder of the folders of tasks; it goes when nothing is left in it.

    Returns:
        how many were moved.
    """
    files, target = sorted(cells.glob("*/*.json")), _pack_of(cells)
    if not files:
        return 0
    found = {name: json.loads(text) for name, text in read_pack(target).items()}
    moved: list[Path] = []
    for file in files:
        try:
            result = json.loads(file.read_text(encoding="utf-8"))
        except ValueError:
            continue  # Damaged: whoever looks for it measures it anew.
        found[f"{file.parent.name}/{file.name}"] = result
        moved.append(file)
    write_pack(target, found)
    for file in moved:
        file.unlink()
    for folder in (*{file.parent for file in moved}, cells):
        if not any(folder.iterdir()):
            folder.rmdir()
    return len(moved)


def _pack_of(folder: Path) -> Path:
    return folder.with_name(folder.name + ENDING)


def read_pack(pack: Path) -> Mapping[str, str]:
    """Name -> JSON of every result of a pack; nothing where there is none.

    Raises:
        OSError, ValueError: for what is no pack.
    """
    return _read(pack, pack.stat().st_mtime_ns) if pack.is_file() else {}


def write_pack(pack: Path, results: Mapping[str, Mapping[str, Any]]) -> None:
    """Write a pack, all or nothing; the same results are the same bytes.

    Args:
        pack: ``NAME.jsonl.gz``.
        results: results by name; what is not among them is in the pack no more.

    Raises:
        InputError: where it cannot be written.
    """
    text = "".join(json.dumps({"name": name, **results[name]}) + "\n" for name in sorted(results))
    # The header of the archive has a time, which would make other bytes.
    write_file(pack, gzip.compress(text.encode(), 9, mtime=0), "results")


@lru_cache(maxsize=8)
def _read(pack: Path, _: int) -> dict[str, str]:
    found: dict[str, str] = {}
    for line in gzip.decompress(pack.read_bytes()).decode().splitlines():
        # The name is the first key; what it names is read when somebody asks for it.
        name = json.JSONDecoder().raw_decode(line, len('{"name": '))[0]
        found[name] = "{" + line[len('{"name": ') + len(json.dumps(name)) + 2 :]
    return found
