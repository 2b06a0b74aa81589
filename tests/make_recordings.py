"""Makes ``tests/data/recordings.jsonl.gz``: a part of the recordings of the published simulator.

The whole of them (../shared/reference, 1.6 MB packed) is optional data beside the checkout; tests
use it where it is present and this part otherwise. Of the steps with cubes and without an arm
every second episode is kept, of everything else all, without the fields that nothing here reads.
A line begins with the name of the file it is of.

Usage: ``python tests/make_recordings.py [REFERENCE]``
"""

from __future__ import annotations

import gzip
import itertools
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT.parent / "shared" / "reference"
SAMPLE = Path(__file__).parent / "data" / "recordings.jsonl.gz"
UNREAD = {
    "F_plane_before",
    "F_plane_after",
    "F_comp_before",
    "F_comp_after",
    "policy",
    "resampled",
    "mask_diff_px",
    "prev_rew",
    "n_target",
    "px_total_after",
}


def sample_lines(file: Path) -> Iterator[dict[str, Any]]:
    """The lines of a recorded file that belong to the part, without unread fields."""
    every = 2 if re.fullmatch(r"transitions_(1mimic|2wo|4wo)_g\d_n\d+\.jsonl\.gz", file.name) else 1
    with gzip.open(file, "rt", encoding="utf-8") as stream:
        lines = [json.loads(text) for text in stream]
    kept = set(sorted({line.get("ep", 0) for line in lines})[::every])
    for line in lines:
        if line.get("ep", 0) in kept:
            yield {key: value for key, value in line.items() if key not in UNREAD}


def sample_files(reference: Path) -> list[Path]:
    """The recorded files there is a part of."""
    return sorted([*reference.glob("transitions_*.gz"), *reference.glob("resets_*.gz")])


def unpack(folder: Path) -> None:
    """Write the part into a folder, as files of the names that all of it has."""
    with gzip.open(SAMPLE, "rt", encoding="utf-8") as stream:
        for name, lines in itertools.groupby(
            map(json.loads, stream), lambda line: line.pop("file")
        ):
            text = "".join(_line(line) for line in lines)
            (folder / name).write_bytes(gzip.compress(text.encode(), 1))


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, separators=(",", ":")) + "\n"


def main(reference: Path) -> None:
    text = "".join(
        _line({"file": file.name, **line})
        for file in sample_files(reference)
        for line in sample_lines(file)
    )
    # No time and no name in the header: the same lines give the same bytes.
    SAMPLE.write_bytes(gzip.compress(text.encode(), 9, mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else REFERENCE)
