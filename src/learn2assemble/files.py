"""JSON from a user: reading files and checking structure, with the path of whatever is wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError

MAX_BYTES = 1_000_000
"""Largest file [bytes]."""


class _Object(dict[str, Any]):
    """A JSON object that remembers a key it was given twice."""

    repeated: str | None = None


def _object(pairs: list[tuple[str, Any]]) -> _Object:
    made = _Object()
    for key, value in pairs:
        if key in made:
            made.repeated = key
        made[key] = value
    return made


def load_json(text: str, source: str, form: str) -> Any:
    """The value in JSON text of the format ``form``.

    It is ``json.loads`` that keeps track of repeated keys; every fault is an :class:`InputError`.
    """
    if not text.strip():
        raise InputError(source, "an empty file", f"a JSON object of format {form!r}")
    try:
        return json.loads(text, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        where = f"{source}: line {error.lineno} column {error.colno}"
        raise InputError(where, error.msg, "JSON") from None
    except ValueError:  # Python's limit on the digits of an integer
        got = "an integer of thousands of digits"
        raise InputError(source, got, "numbers of ordinary size") from None
    except RecursionError:
        raise too_deep(source) from None


def too_deep(source: str) -> InputError:
    """The error for JSON that is nested deeper than Python likes."""
    return InputError(source, "brackets nested too deeply", "a few levels")


def read_text(path: Path, kind: str) -> tuple[str, str]:
    """The text of a file of the ``kind`` (``"design file"``), and what messages call it.

    Raises:
        InputError: for a file that is missing, unreadable, larger than 1 MB or not UTF-8.
    """
    path = Path(path)
    source = printable(str(path))
    try:
        if path.is_dir():
            raise InputError(source, "a directory", f"a {kind}")
        if not path.exists():
            raise InputError(source, "no such file", f"a {kind}")
        if not path.is_file():  # opening a pipe would wait for ever
            raise InputError(source, "something that is not a plain file", f"a {kind}")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(source, reason, f"a readable {kind}") from None
    if len(content) > MAX_BYTES:
        raise InputError(source, f"more than {MAX_BYTES} bytes", f"a {kind} of at most 1 MB")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        got = f"byte 0x{content[error.start]:02x} at offset {error.start}"
        raise InputError(source, got, "UTF-8 text") from None
    return text, source


def printable(source: str) -> str:
    """A file name fit for a one-line message: line breaks and undecodable bytes are escaped."""
    return source if source.isprintable() else ascii(source)


def check_keys(
    given: Mapping[str, Any], source: str, path: str, valid: tuple[str, ...], need: tuple[str, ...]
) -> None:
    """Refuse keys given twice, unknown ones, and the lack of needed ones."""
    where = f"{source}: key of {path}" if path else f"{source}: key"
    repeated = getattr(given, "repeated", None)
    if repeated is not None:
        raise InputError(where, repeated, "every key once")
    for key in given:
        if key not in valid:
            raise UnknownNameError(where, key, valid)
    for key in need:
        if key not in given:
            wanted = f"the key {key!r}" + (f" in {path}" if path else "")
            raise InputError(f"{source}: {path}" if path else source, sorted(given), wanted)


def read_head(
    value: Any, source: str, form: str, version: int, valid: tuple[str, ...], need: tuple[str, ...]
) -> Mapping[str, Any]:
    """The JSON object of a file in metres, once its format, keys and version are as they should."""
    root = mapping(value, source)
    # The format comes first: a foreign file should say that it is foreign.
    if "format" in root and root["format"] != form:
        raise InputError(f"{source}: format", root["format"], repr(form))
    check_keys(root, source, "", valid, need)
    given = integer(root["version"], f"{source}: version")
    if given != version:
        raise InputError(f"{source}: version", given, f"{version}")
    if root.get("units", "m") != "m":
        raise InputError(f"{source}: units", root["units"], "'m'; all lengths are metres")
    return root


def mapping(value: Any, where: str) -> Mapping[str, Any]:
    """``value`` where it is a JSON object."""
    if not isinstance(value, Mapping):
        raise InputError(where, value, "a JSON object {...}")
    return value


def sequence(value: Any, where: str, expected: str) -> list[Any] | tuple[Any, ...]:
    """``value`` where it is a list."""
    if not isinstance(value, list | tuple):
        raise InputError(where, value, expected)
    return value


def text(value: Any, where: str) -> str:
    """``value`` where it is text."""
    if not isinstance(value, str):
        raise InputError(where, value, "text")
    return value


def integer(value: Any, where: str) -> int:
    """``value`` where it is a whole number."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(where, value, "an integer")
    return value


def number(value: Any, where: str) -> float:
    """``value`` where it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(where, value, "a number")
    try:
        number = float(value)
    except OverflowError:
        raise InputError(where, "a number beyond 1e308", "a finite number") from None
    if not np.isfinite(number):
        raise InputError(where, value, "a finite number")
    return number
