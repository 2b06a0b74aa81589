"""Files of a user: bounded reading, values by their type, writing all or nothing; interrupts."""

from __future__ import annotations

import ctypes
import gzip
import json
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from l2a_lab.__main__ import command_line
from learn2assemble.cli import main
from learn2assemble.cli.parser import L2A
from learn2assemble.errors import InputError
from learn2assemble.files import (
    MAX_BYTES,
    MAX_DEPTH,
    append_line,
    claim_folder,
    load_json,
    read_bytes,
    read_json_lines,
    replacing,
    write_file,
)
from learn2assemble.values import Range, from_plain, to_plain

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
            [sys.executable, "-m", "learn2assemble", "tasks"],
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
            str(Path(__file__).parent / "data" / "ascii_wall.json"),
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


@pytest.mark.parametrize("command", ["view", "build", "replay"])
def test_files_that_explode_are_refused_by_commands(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / ("a.jsonl" if command == "replay" else "a.json")
    file.write_text("[" * 100_000 + "]" * 100_000 + "\n")
    more = ["--out", str(tmp_path / "out")] if command == "build" else []
    program = command_line() if command == "replay" else L2A
    assert main([command, str(file), *more], program) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith(f"{program.name}: error: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not hasattr(signal, "SIGINT") or os.name == "nt", reason="needs POSIX signals")
@pytest.mark.parametrize("wait", [0.0, 0.2, 0.5, 1.0])
def test_an_interrupt_ends_with_130_and_no_traceback(wait: float, tmp_path: Path) -> None:
    """From the moment the program runs: while libraries load, and later."""
    code = (
        "import sys; sys.argv = ['l2a', *sys.argv[1:]]\n"
        "from learn2assemble.__main__ import run\n"
        "import signal, threading\n"
        "real = signal.signal\n"
        "def ready(*words):\n"
        "    found = real(*words); print('ready', flush=True); return found\n"
        "signal.signal = ready\n"
        "sys.exit(run())"
    )
    words = ["train", "two-sided-3x3-20-24", "--out", str(tmp_path / "out"), "--minutes", "5"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert err.rstrip().endswith("l2a: interrupted")


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
