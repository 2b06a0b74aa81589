"""What the types of the public API say, by pyright's own count."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "learn2assemble"
OPEN = ("cell/", "simulation/", "planning/disassembly.py")
"""Where attributes are not declared yet."""
UNSAID = ("is missing", "could be inferred differently", "has unknown type", "Type unknown for")
"""Messages about what is not said; all others are of what follows from that elsewhere."""


def unsaid(report: dict) -> list[str]:
    """Every place of a report of ``pyright --verifytypes`` where a public type is not said."""
    return [
        f"{Path(message['file']).relative_to(SOURCE).as_posix()}: {symbol['name']}"
        for symbol in report["typeCompleteness"]["symbols"]
        if not symbol["isTypeKnown"]
        for message in symbol["diagnostics"]
        if message.get("file") and any(words in message["message"] for words in UNSAID)
    ]


@pytest.mark.slow
def test_public_types_are_said() -> None:
    # Pyright asks the Python that it finds first where the package and its libraries are.
    folder = Path(sys.executable).parent
    found = subprocess.run(
        [
            folder / "pyright",
            "--verifytypes",
            "learn2assemble",
            "--ignoreexternal",
            "--outputjson",
        ],
        capture_output=True,
        text=True,
        env=os.environ
        | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT / "src")},
    )
    report = json.loads(found.stdout)
    assert report["typeCompleteness"]["moduleRootDirectory"] == str(SOURCE)
    assert len(report["typeCompleteness"]["symbols"]) > 5000
    assert [place for place in unsaid(report) if not place.startswith(OPEN)] == []


def test_what_is_not_said_is_seen() -> None:
    """The test above can fail."""
    where = str(SOURCE / "robot" / "arm.py")
    message = "Type is missing type annotation and could be inferred differently"
    symbol = {"name": "x", "isTypeKnown": False, "diagnostics": []}
    report = {"typeCompleteness": {"symbols": [symbol]}}
    assert unsaid(report) == []
    symbol["diagnostics"] = [
        {"file": where, "message": message},
        {"file": where, "message": 'Type of parameter "sim" is partially unknown'},
    ]
    assert unsaid(report) == ["robot/arm.py: x"]
