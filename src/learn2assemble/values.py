"""Values of files by their type: JSON and TOML as the dataclasses that say what they mean.

Every fault is an :class:`~learn2assemble.errors.InputError` of one line that names the file and the
path of whatever is wrong in it.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast

import numpy as np

from learn2assemble.errors import InputError, UnknownNameError, printable

T = TypeVar("T")
MAX_DEPTH = 32
"""Brackets within brackets."""
_TOKENS = re.compile(r'"(?:[^"\\]|\\.)*"|[\[{]|[\]}]')
_SUSPICIOUS = re.compile(r"NaN|Infinity|[eE]\+?0*[1-9][0-9]{2}|[0-9]{309}")
"""Occurs in every number that is not finite in float64."""


def rounded(value: float, digits: int = 6) -> float:
    """A number as files and people get it: to so many decimals, and never a zero with a minus."""
    return round(float(value), digits) + 0.0


def rounded_array(values: np.ndarray, digits: int = 6) -> np.ndarray:
    """:func:`rounded` of every number of an array."""
    return np.round(values, digits) + 0.0


def check_keys(
    given: Mapping[str, Any], source: str, path: str, valid: tuple[str, ...], need: tuple[str, ...]
) -> None:
    """Refuse unknown keys, and the lack of needed ones."""
    where = f"{source}: key of {path}" if path else f"{source}: key"
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
    if "format" not in root and "format" in need:
        raise InputError(source, sorted(root), f"the key 'format', with the value {form!r}")
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
    return cast("Mapping[str, Any]", value)


def sequence(value: Any, where: str, expected: str) -> list[Any] | tuple[Any, ...]:
    """``value`` where it is a list."""
    if not isinstance(value, list | tuple):
        raise InputError(where, value, expected)
    return cast("list[Any]", value)


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


def boolean(value: Any, where: str) -> bool:
    """``value`` where it is true or false."""
    if not isinstance(value, bool):
        raise InputError(where, value, "true or false")
    return value


def number(value: Any, where: str) -> float:
    """``value`` where it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(where, value, "a number")
    try:
        number = float(value)
    except OverflowError:
        raise InputError(where, "a number beyond 1e308", "a finite number") from None
    if not math.isfinite(number):
        raise InputError(where, value, "a finite number")
    return number


class By(NamedTuple):
    """What reads a value that no type describes, in an ``Annotated`` type."""

    read: Callable[[Any, str], Any]
    """Of the value and what messages call it."""


class Range(NamedTuple):
    """Bounds of a number, in an ``Annotated`` type."""

    low: float
    high: float
    unit: str = ""


def to_plain(value: Any) -> Any:
    """A dataclass as a JSON value: the opposite of :func:`from_plain`.

    Fields that may be absent and are ``None`` are left out, and those with the metadata
    ``{"file": False}``.
    """
    if dataclasses.is_dataclass(value):
        return {
            item.name: to_plain(found)
            for item in dataclasses.fields(value)
            if item.metadata.get("file", True)
            and ((found := getattr(value, item.name)) is not None or item.default is not None)
        }
    return (
        [to_plain(item) for item in cast("tuple[Any, ...]", value)]
        if isinstance(value, tuple)
        else value
    )


def from_plain(kind: Any, value: Any, source: str, path: str = "") -> Any:
    """A JSON value as the type ``kind``.

    Args:
        kind: a dataclass of such types; bool, int, float, str; tuples; ``Literal``; a union with
            ``None``; ``Annotated`` with a :class:`Range` or a :class:`By`.
        source: what messages call the file.
        path: of the value in the file.

    Raises:
        InputError: naming the file and the path of what is wrong.
    """
    where = f"{source}: {path}" if path else source
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        for reader in (item for item in inside[1:] if isinstance(item, By)):
            return reader.read(value, where)
        made = from_plain(inside[0], value, source, path)
        for low, high, unit in (bound for bound in inside[1:] if isinstance(bound, Range)):
            if made is not None and not low <= made <= high:
                raise InputError(where, value, f"{low:g} to {high:g} {unit}".rstrip())
        return made
    if origin in (Union, types.UnionType):
        (other,) = (item for item in inside if item is not types.NoneType)
        return None if value is None else from_plain(other, value, source, path)
    if origin is Literal:
        if value not in inside:
            raise UnknownNameError(where, value, map(str, inside))
        return value
    if origin is tuple:
        many = len(inside) == 2 and inside[1] is Ellipsis
        words = "a list" if many else f"a list of {len(inside)} values"
        items = sequence(value, where, words)
        if not many and len(items) != len(inside):
            raise InputError(where, value, words)
        kinds = [inside[0]] * len(items) if many else inside
        return tuple(
            from_plain(one, item, source, f"{path}[{k}]")
            for k, (one, item) in enumerate(zip(kinds, items, strict=True))
        )
    if dataclasses.is_dataclass(kind):
        fields = _fields(kind)
        given = mapping(value, where)
        need = tuple(name for name, (_, needed) in fields.items() if needed)
        check_keys(given, source, path, tuple(fields), need)
        prefix = f"{path}." if path else ""
        return kind(
            **{  # pyright: ignore[reportCallIssue, reportUnknownVariableType]
                name: from_plain(fields[name][0], item, source, prefix + name)
                for name, item in given.items()
            }
        )
    return {bool: boolean, int: integer, float: number, str: text}[kind](value, where)


def read_document(
    kind: type[T], value: Any, source: str, form: str, version: int, *others: str
) -> tuple[T, Mapping[str, Any]]:
    """A JSON object of a format of ours as the dataclass ``kind``, and the object.

    Args:
        others: keys that are left to the caller.

    Raises:
        InputError: naming the file and the path of what is wrong.
    """
    fields = _fields(kind)
    need = ("format", "version", *(name for name, (_, needed) in fields.items() if needed))
    valid = ("format", "version", "units", *others, *fields)
    root = read_head(value, source, form, version, valid, need)
    return from_plain(kind, {k: v for k, v in root.items() if k in fields}, source), root


@cache
def _fields(kind: Any) -> dict[str, tuple[Any, bool]]:
    """Type of every field that is in a file, and whether it must be there."""
    fields = [item for item in dataclasses.fields(kind) if item.metadata.get("file", True)]
    named = types.SimpleNamespace(__annotations__={item.name: item.type for item in fields})
    hints = typing.get_type_hints(named, vars(sys.modules[kind.__module__]), include_extras=True)
    missing = dataclasses.MISSING
    return {
        item.name: (hints[item.name], item.default is missing and item.default_factory is missing)
        for item in fields
    }


# ---------------------------------------------------------------- JSON


def load_json(text: str, source: str, form: str) -> Any:
    """The value in JSON text of the format ``form``.

    Raises:
        InputError: for text that is no JSON, brackets nested deeper than ``MAX_DEPTH``, a key given
            twice, and numbers that are not finite.
    """
    if not text.strip():
        raise InputError(source, "an empty file", f"JSON ({form})")
    if text.count("[") + text.count("{") > MAX_DEPTH:
        _check_depth(text, source)

    suspicious = bool(_SUSPICIOUS.search(text))

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        nonlocal suspicious
        made = dict(pairs)
        if len(made) == len(pairs):
            return made
        suspicious = True
        seen = [key for key, _ in pairs]
        return _Repeating(made, key=next(key for key in seen if seen.count(key) > 1))

    try:
        value = json.loads(text, object_pairs_hook=once)
    except json.JSONDecodeError as error:
        where = f"{source}: line {error.lineno} column {error.colno}"
        raise InputError(where, error.msg, "JSON") from None
    except ValueError:  # Python's limit on the digits of an integer
        got = "an integer of thousands of digits"
        raise InputError(source, got, "numbers of ordinary size") from None
    if suspicious:
        _check_tree(value, source, "")
    return value


class _Repeating(dict[str, Any]):
    """A JSON object that was given a key twice."""

    def __init__(self, values: Mapping[str, Any], key: str) -> None:
        super().__init__(values)
        self.key = key


def _check_tree(value: Any, source: str, path: str) -> None:
    """Refuse a repeated key and a number that is not finite, wherever they are."""
    where = f"{source}: {path}" if path else source
    if isinstance(value, _Repeating):
        raise InputError(
            f"{source}: key of {path}" if path else f"{source}: key", value.key, "every key once"
        )
    if isinstance(value, dict):
        for key, item in cast("dict[str, Any]", value).items():
            _check_tree(item, source, f"{path}.{key}" if path else printable(key))
    elif isinstance(value, list):
        for k, item in enumerate(cast("list[Any]", value)):
            _check_tree(item, source, f"{path}[{k}]")
    elif isinstance(value, float):
        number(value, where)


def three(values: Iterable[T]) -> tuple[T, T, T]:
    """Three values of a row, as a checker of types counts them."""
    x, y, z = values
    return x, y, z


def _check_depth(text: str, source: str) -> None:
    depth = 0
    for token in _TOKENS.finditer(text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(token[0], 0)
        if depth > MAX_DEPTH:
            raise too_deep(source)


def too_deep(source: str) -> InputError:
    """The error for JSON whose brackets are nested too deeply."""
    return InputError(source, "brackets nested too deeply", "a few levels")
