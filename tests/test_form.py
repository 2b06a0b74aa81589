"""The form of the code: names, arguments, types of the public API by pyright's own count, and what
the formatter may not touch. The library names arguments; the command line names its options.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

import learn2assemble as l2a
from headless import tree_of
from learn2assemble.cli import main
from learn2assemble.cli.output import Output
from learn2assemble.errors import InputError, as_options

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "learn2assemble"
LABORATORY = ROOT / "laboratory" / "src" / "l2a_lab"
WING = {"tasks", "envs"}
"""The rooms of the paper, which have words of their own."""
MOST_ARGUMENTS = 8
LONG = {
    "jobs/build.py:build": "a public face: everything that can be asked of a build, by name",
    "tasks/learning/run.py:train": "a public face: the options of a training, by name",
    "tasks/learning/run.py:run_training": "the same with everything checked",
    "tasks/evaluation/episodes.py:evaluate": "a public face: the options of an evaluation, by name",
}
"""Functions that have more arguments, and why."""
SAME_NAMES: dict[str, str] = {}
"""Class names that are used twice in the product, and why."""
LAX = {
    "reportAttributeAccessIssue": "MuJoCo's specifications are half typed",
    "reportMissingImports": "a driver that one system alone has",
    "reportUnknownMemberType": "matplotlib names no types of its options",
}
"""Rules of pyright that a file may do without, and why."""


def trees() -> dict[Path, ast.Module]:
    """Every file of the product and the laboratory."""
    return {
        path: tree_of(path)
        for folder in (SOURCE, LABORATORY)
        for path in sorted(folder.rglob("*.py"))
    }


def _place(path: Path) -> str:
    folder = SOURCE if path.is_relative_to(SOURCE) else LABORATORY
    return path.relative_to(folder).as_posix()


def _is_kernel(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any("kernel" in ast.dump(decorator) for decorator in function.decorator_list)


def long_functions(tree: ast.Module) -> list[str]:
    """Names of functions with too many arguments that are no compiled kernels."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not _is_kernel(node):
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args)]
            count = len(names) - (names[:1] in (["self"], ["cls"])) + len(node.args.kwonlyargs)
            found += [node.name] * (count > MOST_ARGUMENTS)
    return found


def test_no_class_name_is_used_twice_in_the_product() -> None:
    """Private names, too; a leading underscore makes no other name."""
    homes = defaultdict(list)
    for path, tree in trees().items():
        if path.is_relative_to(SOURCE) and path.relative_to(SOURCE).parts[0] not in WING:
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef):
                    homes[node.name.lstrip("_")].append(f"{_place(path)}:{node.name}")
    assert len(homes) > 200
    twice = {name: where for name, where in homes.items() if len(where) > 1}
    assert twice.keys() == SAME_NAMES.keys(), twice


def test_functions_have_few_arguments() -> None:
    found = {
        f"{_place(path)}:{name}" for path, tree in trees().items() for name in long_functions(tree)
    }
    assert found == LONG.keys()


def test_long_functions_are_seen() -> None:
    """The test above can fail."""
    names = "abcdefghi"
    plain = f"def f({', '.join(names)}): pass\nclass C:\n def g(self, {', '.join(names[1:])}): pass"
    assert long_functions(ast.parse(plain)) == ["f"]
    assert long_functions(ast.parse(f"@kernel\ndef f({', '.join(names)}): pass")) == []
    assert long_functions(ast.parse(f"def f(a, *, {', '.join(names[1:])}): pass")) == ["f"]


def test_the_formatter_decides() -> None:
    words = "# fmt: " + "skip"
    off = "# fmt: " + "off"
    # Not what lies in folders like .venv, which are large.
    files = [*ROOT.glob("*.py"), *(p for top in ROOT.glob("[!.]*/") for p in top.rglob("*.py"))]
    texts = [path.read_text(encoding="utf-8") for path in files]
    assert len(texts) > 200
    assert sum(text.count(words) for text in texts) <= 20
    assert not any(off in text for text in texts)


def test_every_room_is_checked_strictly() -> None:
    said = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pyright"]
    assert said["include"] == said["strict"] == ["src", "laboratory/src"]
    assert not [key for key in said if key.startswith("report") or key in ("exclude", "ignore")]
    texts = [path.read_text(encoding="utf-8") for path in trees()]
    assert {word for text in texts for word in loosened(text)} == {f"{rule}=false" for rule in LAX}


def loosened(text: str) -> list[str]:
    """What the comments of a file allow in all of it, and comments that say no rule."""
    unnamed = re.findall(r"# (?:type|pyright): ignore(?!\[)", text)
    return unnamed + re.findall(r"^# pyright: (.*)", text, re.MULTILINE)


def test_what_is_loosened_is_seen() -> None:
    """The test above can fail."""
    text = "# pyright: basic\na = 1  # pyright: ignore[reportX]\nb = 2  # type: ignore\n"
    assert loosened(text) == ["# type: ignore", "basic"]


def unsaid(report: dict) -> list[str]:
    """Every public name of a report of ``pyright --verifytypes`` whose type is not said."""
    return [
        symbol["name"]
        for symbol in report["typeCompleteness"]["symbols"]
        if symbol["isExported"] and not symbol["isTypeKnown"]
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
    assert unsaid(report) == []
    assert report["typeCompleteness"]["completenessScore"] == 1


def test_what_is_not_said_is_seen() -> None:
    """The test above can fail."""
    symbol = {"name": "x", "isExported": True, "isTypeKnown": True}
    report = {"typeCompleteness": {"symbols": [symbol]}}
    assert unsaid(report) == []
    symbol["isTypeKnown"] = False
    assert unsaid(report) == ["x"]


OPTIONS = ("cli/",)
"""What reads options of the command line."""
OTHERS = {"--error-unmatch", "--short", "--h:"}
"""Options of another program, and what a style sheet calls its own."""
STILL = {"acting/journal.py", "export/robot_programs.py"}
"""Files whose names of options are those of what they refuse."""


def test_arguments_become_options() -> None:
    assert as_options("`seconds=` gives more") == "--seconds gives more"
    assert as_options("with `tool=suction-side` it does") == "with --tool suction-side it does"
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
    said.table("", ("quantity", "value [mm]"), [("reason", reason)])
    said.progress(reason)
    said.finish({"reason": reason})
    shown = capsys.readouterr()
    assert shown.err.count("--seconds gives more") == 2
    assert "--seconds gives more" in shown.out
    assert "`" not in shown.err + shown.out
    assert "value [mm]" in shown.err


def test_errors_show_what_was_given() -> None:
    """Not that something was."""
    vague = {
        f"{_place(path)}:{node.lineno}"
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("InputError")
        for got in node.args[1:2]
        if isinstance(got, ast.Constant) and got.value in ("given", "yes", "set", "something")
    }
    assert vague == set()


def test_no_text_of_the_library_names_an_option() -> None:
    found = []
    for path, tree in trees().items():
        name = _place(path)
        if not path.is_relative_to(SOURCE) or name.startswith(OPTIONS) or name in STILL:
            continue
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
            and node.value not in OTHERS
        ]
    assert found == []
