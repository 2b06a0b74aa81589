"""The form of the code: names, arguments, and what the formatter may not touch."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

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


@cache
def trees() -> dict[Path, ast.Module]:
    """Every file of the product and the laboratory."""
    return {
        path: ast.parse(path.read_text(encoding="utf-8"))
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
