"""Files of a user: bounded reading of JSON, writing all or nothing, a folder to oneself.

Every fault is an :class:`~learn2assemble.errors.InputError` of one line that names the file and the
JSON path of whatever is wrong.
"""

from __future__ import annotations

import difflib
import gzip
import os
import stat
import zlib
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from learn2assemble.errors import InputError, Remedy, printable
from learn2assemble.values import load_json, mapping

MAX_BYTES = 1_000_000
"""Largest file a person writes [bytes]."""
MAX_GENERATED = 100_000_000
"""Largest file a program writes: plans, trajectories, logs, recordings [bytes, unpacked]."""
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
"""Lengths of units people write [m]."""
FARTHEST = 1e9
"""Largest coordinate of a drawing or a mesh, in its unit."""
# ---------------------------------------------------------------- reading


def nearest(path: Path) -> str:
    """Words for a message about a file that does not exist: the name in its folder that is most
    like its own, with another ending or another name, or nothing."""
    try:
        names = sorted(item.name for item in path.parent.iterdir() if item.exists())
    except (OSError, ValueError):  # No such folder, or one that must not be read.
        return ""
    # By the name alone: files of one kind have their ending in common, whatever they are.
    like = set(
        difflib.get_close_matches(path.stem, [Path(name).stem for name in names], cutoff=0.6)
    )
    same = like & {path.stem} or like
    alike = [name for name in names if Path(name).stem in same]
    near = difflib.get_close_matches(path.name, alike, n=1, cutoff=0.0)
    return f"; did you mean {printable(str(path.with_name(near[0])))!r}?" if near else ""


def as_path(value: object, kind: str) -> Path:
    """The name of a file or folder that a caller gives, which is called ``kind`` in messages.

    Raises:
        InputError: for what is no name, and an empty one.
    """
    if not isinstance(value, str | Path) or not str(value) or "\0" in str(value):
        raise InputError(kind, value, "the name of a file or folder")
    return Path(value)


def check_exists(path: Path, kind: str) -> None:
    """Refuse a name that no file or folder has.

    Args:
        kind: what is looked for, in words (``"design file"``).

    Raises:
        InputError: with the nearest name in the same folder.
    """
    try:
        there, link = os.path.exists(path), os.path.islink(path)
    except ValueError:
        raise InputError(printable(str(path)), "no file name", f"a {kind}") from None
    if not there:
        got = "a link to nowhere" if link else "no such file"
        raise InputError(printable(str(path)), got, f"a {kind}{nearest(path)}")


def read_bytes(path: Path, kind: str, limit: int = MAX_BYTES) -> tuple[bytes, str]:
    """The content of a file of the ``kind`` (``"design file"``), and what messages call it.

    Args:
        limit: most bytes it may have; a file ``*.gz`` is unpacked and may have as many unpacked.

    Raises:
        InputError: for a file that is missing, unreadable or too large.
    """
    path = Path(path)
    source = printable(str(path))
    check_exists(path, kind)
    try:
        if path.is_dir():
            raise InputError(source, "a directory", f"a {kind}")
        if not path.is_file():  # opening a pipe would wait for ever
            raise InputError(source, "something that is not a plain file", f"a {kind}")
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(source, reason, f"a readable {kind}") from None
    if len(content) > limit:
        size = f"at most {limit // 1_000_000} MB"
        raise InputError(source, f"more than {limit} bytes", f"a {kind} of {size}")
    return content, source


def read_text(path: Path, kind: str, limit: int = MAX_BYTES) -> tuple[str, str]:
    """The text of a file, see :func:`read_bytes`.

    Raises:
        InputError: also for what is not UTF-8.
    """
    content, source = read_bytes(path, kind, limit)
    return decoded(content, source), source


def decoded(content: bytes, source: str) -> str:
    """The text of UTF-8 bytes; messages call their file ``source``."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        got = f"byte 0x{content[error.start]:02x} at offset {error.start}"
        raise InputError(source, got, "UTF-8 text") from None


def read_json(path: Path, kind: str, limit: int = MAX_GENERATED) -> tuple[Any, str]:
    """The value in a JSON file, and what messages call the file."""
    text, source = read_text(path, kind, limit)
    return load_json(text, source, kind), source


def read_json_lines(path: Path, kind: str) -> Iterator[Mapping[str, Any]]:
    """The JSON objects in the lines of a file, one at a time; of ``*.gz`` unpacked.

    Raises:
        InputError: naming file and line, for a file that is missing or unreadable, a line of more
            than ``MAX_BYTES`` and one that is no JSON object.
    """
    path, number = Path(path), 0
    check_exists(path, kind)
    if not path.is_file():
        raise InputError(printable(str(path)), "something that is not a plain file", f"a {kind}")
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            while line := file.readline(MAX_BYTES + 1):
                number += 1
                where = f"{printable(path.name)} line {number}"
                if len(line) > MAX_BYTES:
                    raise InputError(where, f"more than {MAX_BYTES} bytes", "a JSON object")
                try:
                    value = load_json(line.decode(), where, kind)
                except UnicodeDecodeError:
                    raise InputError(where, "bytes that are not UTF-8", "a JSON object") from None
                yield mapping(value, where)
    except (OSError, EOFError, zlib.error) as error:
        where = f"{printable(path.name)} line {max(number, 1)}"
        raise InputError(where, str(error) or type(error).__name__, "a JSON object") from None


# ---------------------------------------------------------------- writing


_NOT_PLAIN = (
    (stat.S_ISLNK, "a symbolic link"),
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def not_plain(path: Path) -> str | None:
    """What stands at a path where it is no plain file, in words; None for a plain file and where
    nothing is.

    A link is named, whatever it leads to; links among the folders above are followed.
    """
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISREG(mode):
        return None
    return next((words for kind, words in _NOT_PLAIN if kind(mode)), "something else")


def check_output(path: Path, what: str) -> None:
    """Refuse a place where no plain file can be written, before any work is done for it.

    Args:
        path: a plain file, or a new name in a folder that exists.
        what: the thing that will be written, for messages.

    Raises:
        InputError: for a link, a folder, a pipe, a socket, a device, a file that must not be
            changed, and a place in no folder.
    """
    path = Path(path)
    source, expected = printable(str(path)), "a plain file or a new one"
    if "\0" in str(path):
        raise InputError(what, source, expected)
    try:
        found = not_plain(path)
        if found is not None:
            raise InputError(what, source, f"{expected}, not {found}")
        os.stat(path.parent)  # Says why where the folder does not exist.
    except OSError as error:
        raise unwritable(what, path, error) from None
    if path.exists() and not os.access(path, os.W_OK):
        raise unwritable(what, path, PermissionError(13, os.strerror(13)))
    try:
        _beside(path).unlink()  # Rights alone do not say: the folder may take no files at all.
    except OSError as error:
        raise unwritable(what, path, error) from None


def check_new(path: Path, what: str, *inputs: object, overwrite: bool | None = None) -> None:
    """The rule for every file whose name a caller gives: nothing is there yet.

    Args:
        path, what: see :func:`check_output`.
        inputs: what the same call reads; of these, names of files and folders are never replaced.
        overwrite: whether another file is; None where the caller has no argument of that name.

    Raises:
        InputError: for a file that is there, and what :func:`check_output` refuses.
    """
    name = printable(str(path))
    if any(isinstance(one, str | Path) and _reads(Path(one), path) for one in inputs):
        raise InputError(what, name, "a new file, not one that the same call reads")
    if not overwrite and os.path.lexists(path) and not_plain(path) is None:
        remedies = () if overwrite is None else (Remedy("overwrite", True, "replaces it"),)
        raise InputError(what, name, "a new file", *remedies)
    check_output(path, what)


def _reads(given: Path, path: Path) -> bool:
    """Whether who is given a file or folder to read reads the file ``path``: of a plan all parts,
    of another folder whatever is in it."""
    try:
        if path.samefile(given):
            return True
        folder = given if given.is_dir() else given.parent
        if not path.parent.samefile(folder):
            return False
        if (folder / "plan.json").is_file():
            return path.name in ("plan.json", "assembly.json") or path.match("trajectory*.json")
        return given.is_dir()
    except (OSError, ValueError):  # One of them is not there.
        return False


def _beside(path: Path) -> Path:
    """A new, empty file in the same folder, of a name that nobody else has put there."""
    part = path.with_name(f".{os.urandom(6).hex()}.part")
    os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return part


@contextmanager
def replacing(path: Path, what: str) -> Generator[Path, None, None]:
    """Write a file all or nothing: under another name first, which then takes its place.

    Args:
        path: what is replaced; see :func:`check_output`.
        what: the thing that is written, for messages.

    Yields:
        An empty file beside it, which whatever writes opens by its name. Where the block fails it
        is removed, and ``path`` is as it was.

    Raises:
        InputError: where it cannot be written, saying why.
    """
    path = Path(path)
    check_output(path, what)
    try:
        part = _beside(path)
        try:
            yield part
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(what, path, error) from None


def write_file(path: Path, content: str | bytes, what: str) -> None:
    """Write a file all or nothing, see :func:`replacing`.

    Args:
        content: bytes, or text; what UTF-8 cannot say of it (parts of names that are not UTF-8) is
            escaped.
        what: the thing that is written, for messages.

    Raises:
        InputError: where it cannot be written, saying why.
    """
    if isinstance(content, str):
        content = content.encode(errors="backslashreplace")
    with replacing(path, what) as part:
        part.write_bytes(content)


def append_line(path: Path, line: str, what: str) -> None:
    """Append a line to a plain file; it is on the disk when this returns, or not at all.

    Raises:
        InputError: where it cannot be written, saying why; the file is as it was.
    """
    check_output(path, what)
    try:
        size = path.stat().st_size if path.exists() else 0
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            if path.exists():
                os.truncate(path, size)
            raise
    except OSError as error:
        raise unwritable(what, path, error) from None


def unwritable(what: str, path: Path, error: OSError) -> InputError:
    """The error for a file or folder that cannot be written: a full disk, no right, no folder."""
    reason = error.strerror or type(error).__name__
    return InputError(what, printable(str(path)), f"a place that can be written ({reason})")


def make_folder(folder: Path, what: str) -> None:
    """A folder that is there from now on.

    Args:
        what: the folder is for, for messages.

    Raises:
        InputError: where it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        expected = f"a writable folder, or one that can be made ({error.strerror or error})"
        raise InputError(what, printable(str(folder)), expected) from None


LOCK = ".lock"
ALONE = "a folder that nothing else is writing into"


@contextmanager
def alone_in(folder: Path, what: str) -> Generator[None, None, None]:
    """Keep other processes that write out of a folder that is there, while the block runs.

    Args:
        folder: whatever it holds.
        what: names it in messages.

    Raises:
        InputError: where another process is writing into it, or none can.
    """
    try:
        lock = _open_lock(folder / LOCK)
    except OSError as error:
        raise unwritable(what, folder, error) from None
    with lock:
        if not _locked(lock):
            raise InputError(what, printable(str(folder)), ALONE)
        try:
            yield
        finally:
            (folder / LOCK).unlink(missing_ok=True)


@contextmanager
def claim_folder(
    folder: Path, resume: bool = False, otherwise: str = ""
) -> Generator[None, None, None]:
    """Have an output folder to oneself while the block runs.

    Args:
        folder: new or empty; made where it does not exist.
        resume: it exists already and holds something.
        otherwise: words for what can be done with one that holds something, beside naming another
            one and emptying it.

    Raises:
        InputError: where it cannot be used, or another process is writing into it.
    """
    what, name, made = "out", printable(str(folder)), False
    expected = "a new or empty folder"
    if "\0" in str(folder):
        raise InputError(what, name, expected)
    try:
        if not resume:
            if folder.exists() and not folder.is_dir():
                raise InputError(what, name, expected)
            if folder.exists() and _content(folder):
                raise holds_something(folder, otherwise)
            made = not folder.exists()
            if made and folder.is_symlink():
                raise InputError(what, name, f"{expected}, not a link to nowhere")
            folder.mkdir(parents=True, exist_ok=True)
        _check_content(folder, what)
        with alone_in(folder, what):
            if not resume and _content(folder):
                raise InputError(what, name, ALONE)
            try:
                yield
            finally:
                (folder / LOCK).unlink(missing_ok=True)
                if made and not _content(folder):
                    folder.rmdir()
    except OSError as error:
        named = folder if error.filename is None else Path(error.filename)
        if folder not in (named, *named.parents) and named not in folder.parents:
            raise  # Another file is to blame.
        raise unwritable(what, folder, error) from None


def holds_something(folder: Path, otherwise: str = "") -> InputError:
    """The error for an output folder that is not empty, with what can be done; see
    :func:`claim_folder`."""
    ways = ["name another one", "empty this one", *([otherwise] if otherwise else [])]
    expected = f"a new or empty folder: {', '.join(ways[:-1])} or {ways[-1]}"
    return InputError("out", printable(str(folder)), expected)


def _check_content(folder: Path, what: str) -> None:
    """Refuse a folder in which something of another program could be written through: files are
    replaced in it, some only when hours of work are done."""
    for path in sorted(folder.iterdir()):
        found = not_plain(path)
        if found not in (None, "a folder"):
            got = printable(str(path))
            raise InputError(what, got, f"only plain files and folders in it, not {found}")


def _open_lock(path: Path) -> IO[str]:
    """The lock, which is opened without following a link or waiting for a pipe."""
    flags = os.O_CREAT | os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    return os.fdopen(os.open(path, flags, 0o666), "w")


def _content(folder: Path) -> bool:
    return any(path.name != LOCK for path in folder.iterdir())


def _locked(file: IO[str]) -> bool:
    """Whether the lock could be taken; the system gives it back when the process ends."""
    try:
        import fcntl
    except ImportError:  # not on this system
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
