"""The library names arguments; the command line names its options."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from learn2assemble.cli import main
from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError, as_options

SOURCE = Path(l2a.__file__).parent
OPTIONS = ("cli/",)
"""What reads options of the command line."""
OF_GIT = {"--error-unmatch", "--short"}
"""Options of another program."""
STILL = {"cell/journal.py", "export/robot_programs.py"}
"""Files whose names of options are those of what they refuse."""


def test_arguments_become_options() -> None:
    assert as_options("`seconds=` gives more") == "--seconds gives more"
    assert as_options("`tool=suction-side`, may") == "--tool suction-side, may"
    assert as_options("`cells_wide=4`") == "--cells-wide 4"
    assert as_options("kit `bricks` does; a == b") == "kit `bricks` does; a == b"


def test_an_error_names_the_argument_in_python_and_the_option_in_a_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=r"an arm to build with .`arm=`"):
        l2a.build(np.ones((2, 2, 2), bool), tool="suction")
    design = tmp_path / "design.npy"
    np.save(design, np.ones((2, 2, 2), bool))
    assert main(["build", str(design), "--tool", "suction", "--out", str(tmp_path / "o")]) == 2
    assert "an arm to build with (--arm)" in capsys.readouterr().err


def test_a_reason_names_the_option_where_it_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    reason = "time ran out after 60 s; `seconds=` gives more"
    said = Output(True)
    said.table("", ("quantity", "value"), [("reason", reason)])
    said.progress(reason)
    said.finish({"reason": reason})
    shown = capsys.readouterr()
    assert shown.err.count("--seconds gives more") == 2
    assert "--seconds gives more" in shown.out
    assert "`" not in shown.err + shown.out


def test_no_text_of_the_library_names_an_option() -> None:
    found = []
    for path in SOURCE.rglob("*.py"):
        name = path.relative_to(SOURCE).as_posix()
        if name.startswith(OPTIONS) or name in STILL:
            continue
        tree = ast.parse(path.read_text("utf-8"))
        texts = {
            node.body[0].value
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        found += [
            f"{name}:{node.lineno}: {node.value}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and node not in texts
            and re.search(r"(^|[ (])--[a-z]", node.value)
            and node.value not in OF_GIT
        ]
    assert found == []
