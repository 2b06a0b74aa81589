"""Files of a user: bounded reading, values by their type, writing all or nothing; interrupts.

Nothing that is there is written over, whatever a command or a call is told to write.
"""

from __future__ import annotations

import argparse
import ctypes
import gzip
import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import learn2assemble as l2a
from learn2assemble.cli import main
from learn2assemble.cli.parser import L2A, CommandLine, make_parser
from learn2assemble.errors import InputError
from learn2assemble.files import (
    MAX_BYTES,
    append_line,
    check_new,
    claim_folder,
    read_bytes,
    read_json_lines,
    replacing,
    write_file,
)
from learn2assemble.values import MAX_DEPTH, Range, from_plain, load_json, to_plain

WALL = str(Path(__file__).parent / "data" / "example_plan" / "assembly.json")
"""An assembly that can be checked."""
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4)
    ),
    max_leaves=20,
)


@given(JSON)
def test_json_is_read_as_python_reads_it(value: Any) -> None:
    text = json.dumps(value)
    assert load_json(text, "file", "form") == value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested too deeply"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": {"b": 1, "b": 2}}', "key of a"),
        ('{"a": [1, NaN]}', "a[1]"),
        ('{"a": -Infinity}', "a: got -inf"),
        ('{"a": 1e999}', "a: got inf"),
        ("1" * 5000, "thousands of digits"),
        ("{]", "line 1 column 2"),
        ("  ", "an empty file"),
    ],
)
def test_what_is_no_such_json_is_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_json(text, "file", "form")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_brackets_in_words_are_not_depth() -> None:
    word = "[{" * 100 + '\\"[' * 3
    assert load_json(json.dumps([word]), "file", "form") == [word]


def test_what_explodes_is_read_up_to_its_limit(tmp_path: Path) -> None:
    bomb = tmp_path / "bomb.json.gz"
    with gzip.open(bomb, "wb", 1) as file:
        for _ in range(3):
            file.write(b"\0" * MAX_BYTES)
    with pytest.raises(InputError, match="more than"):
        read_bytes(bomb, "file")
    with pytest.raises(InputError, match="line 1: got 'more than"):
        list(read_json_lines(bomb, "recording"))


@dataclass(frozen=True)
class Inner:
    size: Annotated[float, Range(0, 10)]
    kind: Literal["a", "b"] = "a"


@dataclass(frozen=True)
class Outer:
    name: str
    inner: tuple[Inner, ...]
    place: tuple[float, float] | None = None
    ready: bool = False


@given(
    st.builds(
        Outer,
        st.text(),
        st.lists(st.builds(Inner, st.floats(0, 10), st.sampled_from("ab"))).map(tuple),
        st.none() | st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
        st.booleans(),
    )
)
def test_a_value_is_read_as_it_was_written(value: Outer) -> None:
    assert from_plain(Outer, json.loads(json.dumps(to_plain(value))), "file") == value


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"name": 1, "inner": []}, "name: got 1, expected text"),
        ({"name": "x"}, "the key 'inner'"),
        ({"name": "x", "inner": [{"size": 11}]}, "inner[0].size: got 11, expected 0 to 10"),
        ({"name": "x", "inner": [{"size": True}]}, "a number"),
        ({"name": "x", "inner": [{"size": 1, "kind": "c"}]}, "one of a, b"),
        ({"name": "x", "inner": [], "place": [1]}, "a list of 2 values"),
        ({"name": "x", "inner": [], "raedy": True}, "did you mean 'ready'"),
    ],
)
def test_a_value_of_another_type_is_refused(data: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        from_plain(Outer, data, "file")
    assert words in str(caught.value)


def test_a_file_is_written_all_or_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    write_file(path, "old", "plan")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match=r"plan: .*No space left on device"):
        write_file(path, "new", "plan")
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]
    with pytest.raises(InputError, match="No such file"):
        write_file(tmp_path / "no" / "a.json", "new", "plan")


@pytest.mark.parametrize("kind", ["link", "dangling", "folder", "pipe", "socket", "device"])
def test_only_plain_files_are_replaced(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, other = tmp_path / "out", tmp_path / "other"
    other.write_text("mine")
    if kind in ("link", "dangling"):
        path.symlink_to(other if kind == "link" else tmp_path / "nosuch")
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(path))
    else:
        path.write_text("mine")
        monkeypatch.setattr(stat, "S_ISREG", lambda mode: False)
        monkeypatch.setattr("learn2assemble.files._NOT_PLAIN", ((lambda mode: True, "a device"),))
    before = os.lstat(path)
    for write in (write_file, append_line):
        with pytest.raises(InputError, match="a plain file or a new one, not a"):
            write(path, "new", "plan")
    assert os.lstat(path) == before
    assert other.read_text() == "mine"
    assert {file.name for file in tmp_path.iterdir()} == {"out", "other"}


def test_links_above_a_file_are_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_file(tmp_path / "link" / "a.json", "new", "plan")
    assert (tmp_path / "real" / "a.json").read_text() == "new"
    with claim_folder(tmp_path / "link", resume=True):
        pass


def test_a_lock_is_not_opened_through_a_link(tmp_path: Path) -> None:
    folder, other = tmp_path / "run", tmp_path / "other"
    folder.mkdir()
    other.write_text("mine")
    (folder / ".lock").symlink_to(other)
    with pytest.raises(InputError, match="not a symbolic link"), claim_folder(folder):
        pass
    assert other.read_text() == "mine"


def test_a_full_disk_leaves_what_there_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.jsonl"
    append_line(path, "first", "log")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(InputError, match="No space left"):
            append_line(path, "second", "log")
    assert path.read_text() == "first\n"

    def write_half() -> None:
        with replacing(path, "log") as part:
            part.write_text("half")
            full()

    with pytest.raises(InputError, match="No space left"):
        write_half()
    assert path.read_text() == "first\n"
    assert [file.name for file in tmp_path.iterdir()] == ["log.jsonl"]


def test_letters_that_utf8_cannot_say_are_escaped(tmp_path: Path) -> None:
    write_file(tmp_path / "a.html", "caf\udce9", "page")
    assert (tmp_path / "a.html").read_text() == "caf\\udce9"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_output_is_told_in_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "learn2assemble", "check", WALL],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "No space left on device" in line


def test_names_an_ascii_terminal_cannot_show_are_escaped(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "learn2assemble",
            "export",
            WALL,
            "--format",
            "glb",
            "--out",
            str(tmp_path / "caf\u00e9.glb"),
        ],
        capture_output=True,
        check=False,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0, done.stderr
    assert b"caf\\xe9.glb" in done.stdout


@pytest.mark.parametrize("command", ["view", "build"])
def test_files_that_explode_are_refused_by_commands(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--out", str(tmp_path / "out")] if command == "build" else []
    check_explosive([command], more, L2A, tmp_path / "a.json", capsys)
    assert not (tmp_path / "out").exists()


def check_explosive(
    words: list[str],
    more: list[str],
    program: CommandLine,
    file: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A command refuses a file of brackets that are nested too deeply."""
    file.write_text("[" * 100_000 + "]" * 100_000 + "\n")
    assert main([*words, str(file), *more], program) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith(f"{program.name}: error: ")


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
def test_an_interrupt_that_a_compiler_drops_comes_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(options: object, output: object) -> int:
        ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))()
        time.sleep(60)
        return 0

    parser = SimpleNamespace(
        parse_args=lambda _: SimpleNamespace(run=command, json=False, verbose=False, learns=False)
    )
    monkeypatch.setattr("learn2assemble.cli.make_parser", lambda *_: parser)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert main(["anything"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "l2a: interrupted\n"


def test_a_misspelt_file_is_told_the_nearest_name(tmp_path: Path) -> None:
    (tmp_path / "bridge.json").write_text("{}")
    with pytest.raises(InputError, match=r"no such file.*did you mean '.*/bridge\.json'"):
        read_bytes(tmp_path / "brigde.json", "design file")
    for other in (tmp_path / "nothing.stl", tmp_path / "none" / "bridge.json"):
        with pytest.raises(InputError, match=r"expected a design file$"):
            read_bytes(other, "design file")


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
    for name in ("victim.svg", "victim.png"):
        (tmp_path / name).write_text(MINE)
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
    "the kit of the call": ["build", "gate.svg", "--kit", "my.toml", "--preview", "my.toml"],
    "somebody's file as a preview": [*PREVIEW, "victim.png"],
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


@pytest.mark.parametrize("name", ["my.toml", "victim.svg", "new.jpg", "new"])
def test_a_preview_is_a_png(name: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(here)
    assert main([*PREVIEW, name, "--overwrite"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"--preview: got '{name}', expected a name that ends in .png")
    assert contents(here) == before


def test_a_preview_by_python_is_a_png_too(here: Path) -> None:
    with pytest.raises(l2a.InputError, match=r"new\.jpg', expected a name that ends in \.png"):
        l2a.preview("gate.svg", "new.jpg")
    assert not Path("new.jpg").exists()


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


BLOCK = l2a.Assembly((l2a.box_block("a", np.zeros(3), np.full(3, 0.1)),))
PLAIN: dict[str, Callable[..., Any]] = {
    "write_assembly": lambda file, **more: l2a.write_assembly(BLOCK, file, **more),
    "export_assembly": lambda file, **more: l2a.export_assembly(BLOCK, "glb", file, **more),
    "preview": lambda file, **more: l2a.preview(GATE, file, **more),
}
"""Calls that write a file by a name."""


@pytest.mark.parametrize("name", PLAIN)
def test_calls_write_new_files(name: str, tmp_path: Path) -> None:
    file = tmp_path / "file.png"
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
    "add-arm": "folder",
    "build": "folder and file",
    "calibrate": "file",
    "check": "folder",
    "demonstrate": "folder",  # Of data sets, each of which is new.
    "eval": "file",
    "export": "file",
    "reach": "folder",
    "train": "folder",
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


def commands_that_write(program: CommandLine) -> set[str]:
    return {name for name in program.commands if named_by(program, name)}


def test_every_command_that_writes_is_known() -> None:
    """A new one needs an answer to what it does with files that are there."""
    assert commands_that_write(L2A) == set(WRITES)


@pytest.mark.parametrize(
    "words",
    [
        ["calibrate", "gate.svg", "--readings", "my.toml", "--out", "victim.svg"],
        ["add-arm", "gate.svg", "--out", "plan"],
        ["check", "plan", "--out", "plan"],
        ["reach", "gate.svg", "--arm", "panda", "--out", "plan"],
    ],
)
def test_commands_refuse_what_is_there(
    words: list[str], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(here)
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "new" in line
    assert contents(here) == before
