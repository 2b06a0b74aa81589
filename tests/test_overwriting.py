"""Nothing that is there is written over, whatever a command or a call is told to write."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import learn2assemble as l2a
from l2a_lab.__main__ import command_line
from learn2assemble.cli import main
from learn2assemble.cli.parser import L2A, CommandLine, make_parser
from learn2assemble.files import check_new

ROOT = Path(__file__).resolve().parents[1]
GATE = ROOT / "examples" / "designs" / "gate.svg"
KIT = ROOT / "examples" / "kits" / "soma.toml"
MINE = "mine, and of another program"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a plan."""
    folder = tmp_path_factory.mktemp("built") / "gate"
    l2a.build(GATE).save(folder)
    return folder


@pytest.fixture
def here(built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a drawing, a kit, a plan and a file of somebody else."""
    shutil.copy(GATE, tmp_path / "gate.svg")
    shutil.copy(KIT, tmp_path / "my.toml")
    shutil.copytree(built, tmp_path / "plan")
    (tmp_path / "victim.svg").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


EXPORT = ["export", "plan", "--format"]
PREVIEW = ["build", "gate.svg", "--preview"]
LOSSES: dict[str, list[str]] = {
    "the drawing as its preview": [*PREVIEW, "gate.svg"],
    "the drawing by another name": [*PREVIEW, "plan/../gate.svg"],
    "a kit as a preview": [*PREVIEW, "my.toml"],
    "the kit of the call": ["build", "gate.svg", "--kit", "my.toml", "--preview", "my.toml"],
    "somebody's file as a preview": [*PREVIEW, "victim.svg"],
    "an export": [*EXPORT, "glb", "--out", "victim.svg"],
    "the plan as a bill": [*EXPORT, "bill", "--out", "plan/plan.json"],
    "its blocks": [*EXPORT, "glb", "--out", "plan/assembly.json"],
    "its blocks by the plan": ["export", "plan/plan.json", "--format", "assembly", "--out", "plan"],
    "what its build has written": [*EXPORT, "bill", "--out", "plan"],
    "an assembly by itself": [
        *("export", "plan/assembly.json", "--format", "compas", "--out", "plan/assembly.json"),
    ],
}
READ = {
    name
    for name, words in LOSSES.items()
    if name
    not in (
        "a kit as a preview",
        "somebody's file as a preview",
        "an export",
        "what its build has written",
    )
}
"""Those that would write over what the same call reads."""


@pytest.mark.parametrize("name", LOSSES)
def test_no_file_is_lost(name: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(here)
    assert main(LOSSES[name]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected a new file" in line
    assert ("--overwrite replaces it" in line) == (name not in READ)
    assert contents(here) == before
    # The option is for what is made again and again, not for what is read.
    assert main([*LOSSES[name], "--overwrite"]) == (2 if name in READ else 0)
    assert (contents(here) == before) == (name in READ or "plan" in LOSSES[name][-1:])
    assert l2a.load_plan("plan").complete


def test_a_second_export_needs_to_be_told(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Into the working folder, by its usual name."""
    assert main([*EXPORT, "glb"]) == 0
    Path("structure.glb").write_text(MINE)
    assert main([*EXPORT, "glb"]) == 2
    assert Path("structure.glb").read_text() == MINE
    assert "--overwrite replaces it" in capsys.readouterr().err
    assert main([*EXPORT, "glb", "--overwrite"]) == 0
    assert Path("structure.glb").read_bytes()[:4] == b"glTF"


def test_overwrite_is_for_files(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A build has a folder of its own."""
    assert main(["build", "gate.svg", "--out", "plan", "--overwrite"]) == 2
    assert "--preview" in capsys.readouterr().err


BLOCK = l2a.Assembly((l2a.box_block("a", (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)),))
PLAIN: dict[str, Callable[..., Any]] = {
    "write_assembly": lambda file, **more: l2a.write_assembly(BLOCK, file, **more),
    "export_assembly": lambda file, **more: l2a.export_assembly(BLOCK, "glb", file, **more),
    "preview": lambda file, **more: l2a.preview(GATE, file, **more),
}
"""Calls that write a file by a name."""


@pytest.mark.parametrize("name", PLAIN)
def test_calls_write_new_files(name: str, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text(MINE)
    with pytest.raises(l2a.InputError, match=r"expected a new file; overwrite=True replaces it"):
        PLAIN[name](file)
    assert file.read_text() == MINE
    PLAIN[name](file, overwrite=True)
    assert file.read_bytes() != MINE.encode()


def test_programs_are_new_files(here: Path) -> None:
    with pytest.raises(l2a.InputError, match="expected a new file; overwrite=True"):
        l2a.export_program("plan", "csv", "victim.svg")
    with pytest.raises(l2a.InputError, match="not one that the same call reads"):
        l2a.export_program("plan", "csv", "plan/plan.json", overwrite=True)


def test_a_calibrated_layout_is_replaced_and_nothing_else(here: Path) -> None:
    """The layout itself where no other file is named; that is refused for what it holds here."""
    for out in ("victim.svg", "gate.svg", "my.toml"):
        with pytest.raises(l2a.InputError, match="expected a new file"):
            l2a.calibrate("gate.svg", "my.toml", out=out)


def test_a_plan_replaces_files_of_plans_alone(here: Path) -> None:
    plan = l2a.load_plan("plan")
    plan.save("plan")
    assert l2a.load_plan("plan").complete
    Path("other").mkdir()
    Path("other/notes.txt").write_text(MINE)
    plan.save("other", page=False)  # What is called otherwise is in nobody's way.
    for name in ("plan.json", "assembly.json", "view.html", "trajectory-1.json"):
        Path(folder := f"of-{name}").mkdir()
        Path(folder, name).write_text(MINE)
        for write in (plan.save, lambda folder: plan.write_page(Path(folder))):
            with pytest.raises(l2a.InputError, match=f"another {name}"):
                write(folder)
        assert contents(Path(folder)) == {name: MINE.encode()}


def test_the_rule_for_files_and_folders_that_are_read(here: Path) -> None:
    """Of a plan its parts, of another folder everything, by whatever name."""
    check_new(Path("plan/structure.glb"), "out", "plan")
    check_new(Path("plan/cards.html"), "out", "plan", overwrite=True)
    os.link("gate.svg", "same.svg")
    for path, read in (
        ("plan/plan.json", "plan"),
        ("plan/assembly.json", Path("plan/plan.json")),
        ("victim.svg", "."),
        ("same.svg", "gate.svg"),
    ):
        with pytest.raises(l2a.InputError, match="not one that the same call reads"):
            check_new(Path(path), "out", read, overwrite=True)


ASKED = {"out", "preview"}
"""Options that name what is written."""
WRITES = {
    "l2a": {
        "add-arm": "folder",
        "build": "folder and file",
        "calibrate": "file",
        "check": "folder",
        "demonstrate": "folder",  # Of data sets, each of which is new.
        "eval": "file",
        "export": "file",
        "reach": "folder",
        "train": "folder",
    },
    "l2a-lab": {
        "curves": "own",
        "fidelities": "file",
        "table": "own",
        "workbenchmark": "own",
        **dict.fromkeys(("measure-builder", "measure-builder-arm", "train-builder"), "folder"),
        **{
            f"measure-{what}": "own"
            for what in (
                *("builds", "designs", "goals", "hidden", "sensing", "speed", "structures"),
                "two-arms",
            )
        },
    },
}
"""What commands write by a name that they are given: new files, new or empty folders, and files of
their own that hold what was measured before."""


def named_by(program: CommandLine, command: str) -> set[str]:
    """Options of a command that name what is written."""
    parser: Any = make_parser([command], program)
    (actions,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    added: Any = actions.choices[command]
    added.fill(added)
    return {action.dest for action in added._actions} & ASKED


@pytest.mark.parametrize("program", [L2A, command_line()], ids=lambda program: program.name)
def test_every_command_that_writes_is_known(program: CommandLine) -> None:
    """A new one needs an answer to what it does with files that are there."""
    found = {name for name in program.commands if named_by(program, name)}
    assert found == set(WRITES[program.name])


@pytest.mark.parametrize(
    "words",
    [
        ["eval", "two-sided-3x3-20-24", "--episodes", "1", "--out", "victim.svg"],
        ["benchmark", "run", "victim.jsonl.gz", "--policy", "random"],
        ["calibrate", "gate.svg", "--readings", "my.toml", "--out", "victim.svg"],
        ["train", "two-sided-3x3-20-24", "--out", "plan"],
        ["add-arm", "gate.svg", "--out", "plan"],
        ["check", "plan", "--out", "plan"],
        ["reach", "gate.svg", "--arm", "panda", "--out", "plan"],
    ],
)
def test_commands_refuse_what_is_there(
    words: list[str], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("victim.jsonl.gz").write_text(MINE)
    before = contents(here)
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "new" in line
    assert contents(here) == before


@pytest.mark.parametrize(
    "words",
    [
        ["fidelities", "robot-two-sided-3x3-10-14", "--out", "victim.svg"],
        ["measure-speed", "--out", "victim.svg"],
        ["workbenchmark", "--tasks", "victim.svg", "--out", "victim.svg"],
        [
            "curves",
            "architectures",
            "--out",
            "pictures",
            "--runs",
            str(ROOT / "results/runs.jsonl.gz"),
        ],
    ],
)
def test_commands_of_the_laboratory_refuse_what_is_there(
    words: list[str], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("pictures").mkdir()
    Path("pictures/architectures.png").write_text(MINE)
    before = contents(here)
    assert main(words, command_line()) == 2
    assert "l2a-lab: error: " in capsys.readouterr().err
    assert contents(here) == before
