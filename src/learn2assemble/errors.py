"""Errors that say what went wrong, what was given and what is allowed.

Every error a user can cause is an :class:`InputError`. Its message is one line, so the
command line can print it unchanged and leave with exit code 2.
"""

from __future__ import annotations

import dataclasses
import difflib
import importlib
import math
import re
from collections.abc import Callable, Collection, Generator, Hashable, Iterable, Mapping, Sequence
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import NamedTuple, TypeVar

T = TypeVar("T")
MANY, NEAREST = 20, 6
"""Of more valid names than this, a message shows only so many of the nearest."""
CLOSE = 0.6
"""A name as alike as this (`difflib`) may have been meant, others have not."""


def printable(source: str) -> str:
    """A file name fit for a one-line message: line breaks and undecodable bytes are escaped."""
    return source if source.isprintable() else ascii(source)


class Learn2AssembleError(Exception):
    """Base of every error this package raises on purpose."""


def as_options(text: str) -> str:
    """A text that names arguments, as `` `seconds=` `` or `` `tool=suction-side` ``, with options
    of the command line instead."""
    return _ARGUMENT.sub(lambda found: f"--{found[1].replace('_', '-')} {found[2]}".strip(), text)


def as_both(text: str) -> str:
    """The same for files and pages, which users of both read: option / argument."""
    return _ARGUMENT.sub(
        lambda found: f"{as_options(found[0])} / {found[1]}={found[2] and repr(found[2])}", text
    )


_ARGUMENT = re.compile(r"`([a-z_]+)=([^`=\n]*)`")


class Remedy(NamedTuple):
    """An argument that would help."""

    argument: str
    value: object
    effect: str
    """What it does, as ``"closes 2 holes"``."""

    @property
    def in_python(self) -> str:
        """As an argument of a function."""
        return f"{self.argument}={self.value!r} {self.effect}"

    @property
    def as_option(self) -> str:
        """As an option of the command line."""
        value = "" if self.value is True else f" {self.value}"
        return f"--{self.argument.replace('_', '-')}{value} {self.effect}"


class InputError(Learn2AssembleError, ValueError):
    """A value given by the caller cannot be used.

    Args:
        what: the thing that is wrong, e.g. ``"task"`` or ``"elevations[0].outline"``.
        got: the offending value; shown with ``repr`` and shortened.
        expected: what would have been accepted, in words.
        remedies: arguments with which it would be.
    """

    def __init__(self, what: str, got: object, expected: str, *remedies: Remedy) -> None:
        self.what = what
        self.got = got
        self.expected = expected
        self.remedies: tuple[Remedy, ...] = remedies
        super().__init__(self._message(remedy.in_python for remedy in remedies))

    def __reduce__(self) -> tuple[type[InputError], tuple[object, ...]]:
        """Errors of other processes arrive with the message they had."""
        return InputError, (self.what, self.got, self.expected, *self.remedies)

    def _message(self, remedies: Iterable[str]) -> str:
        words = f"{self.what}: got {_short(self.got)}, expected {self.expected}"
        return "; ".join((words, *remedies))

    def for_command_line(self) -> str:
        """The message, what would help as options of the command line."""
        return as_options(self._message(remedy.as_option for remedy in self.remedies))


class UnknownNameError(InputError):
    """A name that is not in a table; the message names the nearest valid one."""

    def __init__(self, what: str, got: object, valid: Iterable[str]) -> None:
        names = sorted(valid)
        near = difflib.get_close_matches(str(got), names, n=NEAREST, cutoff=0.4)
        meant = closest(str(got), names)
        hint = f"; did you mean {meant!r}?" if meant else ""
        shown = ", ".join(names) or "none"
        if len(names) > MANY:
            shown = f"{len(names)} names such as {', '.join(near or names[:NEAREST])}"
        elsewhere = getattr(valid, "elsewhere", "")
        super().__init__(what, got, f"one of {shown}{hint}{elsewhere}")


def closest(got: str, valid: Iterable[str]) -> str | None:
    """The one of the ``valid`` names that may have been meant; None where none is close.

    Of a longer name its beginning may be: whoever writes ``sped`` means ``speed_factor``.
    """
    names = list(valid)
    near = difflib.get_close_matches(got, names, n=1, cutoff=CLOSE)
    begun = {name[: len(got)]: name for name in reversed(names) if len(got) > 2}
    near += [begun[one] for one in difflib.get_close_matches(got, begun, n=1, cutoff=CLOSE)]
    return near[0] if near else None


def check_name(what: str, name: object, valid: Collection[str]) -> None:
    """Refuse a name that is not among the ``valid`` ones.

    Raises:
        UnknownNameError: naming the nearest one; ``what`` says what kind of thing it is.
    """
    if not isinstance(name, Hashable) or name not in valid:
        raise UnknownNameError(what, name, valid)


def look_up(what: str, name: str, table: Mapping[str, T]) -> T:
    """The entry of ``table`` called ``name``, see :func:`check_name`."""
    check_name(what, name, table)
    return table[name]


def check_arguments(given: Mapping[str, object], *rules: tuple[str, bool, str]) -> None:
    """Refuse arguments by the first rule they break: name of one, whether it is as it should be,
    and what is expected of it.

    Raises:
        InputError: naming the argument.
    """
    for name, kept, expected in rules:
        if not kept:
            raise InputError(name, given[name], expected)


def check_fields(value: object, *rules: tuple[str, bool, str]) -> None:
    """The same for the fields of a value."""
    check_arguments({name: getattr(value, name) for name, _, _ in rules}, *rules)


def check_types(value: object) -> None:
    """Refuse a value of a dataclass whose fields of simple types hold something else.

    Raises:
        InputError: naming the field.
    """
    for item in dataclasses.fields(value):  # pyright: ignore[reportArgumentType]
        given = getattr(value, item.name)
        kept, expected = _SIMPLE.get(str(item.type), (None, ""))
        if kept is not None and not kept(given):
            raise InputError(item.name, given, expected)


def check_instance(what: str, value: object, kinds: type | tuple[type, ...], words: str) -> None:
    """Refuse a value that is of none of the ``kinds``; ``words`` say what is expected."""
    if not isinstance(value, kinds):
        raise InputError(what, value, words)


def is_number(value: object, low: float = -math.inf, high: float = math.inf) -> bool:
    """Whether it is a finite number from ``low`` to ``high``."""
    try:
        return isinstance(value, Real) and math.isfinite(value) and low <= float(value) <= high
    except OverflowError:  # a whole number larger than any float
        return False


def is_whole(value: object, low: int, high: float = math.inf) -> bool:
    """Whether it is a whole number from ``low`` to ``high``."""
    return isinstance(value, Integral) and low <= int(value) <= high


_SIMPLE: dict[str, tuple[Callable[[object], bool], str]] = {
    "bool": (lambda value: isinstance(value, bool), "True or False"),
    "int": (lambda value: isinstance(value, Integral), "a whole number"),
    "float": (lambda value: isinstance(value, Real), "a number"),
    "str": (lambda value: isinstance(value, str), "a word"),
}
"""Types of fields as they are written, whether a value is of one, and what is expected."""


class SimulationDivergedError(Learn2AssembleError, ArithmeticError):
    """Some position or velocity is not finite any more.

    Args:
        time: since the attempt began [s].
        folder: has ``scene.xml``, the model, and ``state.npz``: ``qpos``, ``qvel``, ``ctrl``,
            ``time``, ``stage`` and ``began``, the poses of the objects at the beginning.
    """

    time: float
    folder: Path

    def __init__(self, time: float, folder: Path) -> None:
        super().__init__(f"simulation diverged at {time:.3f} s; model and state are in {folder}")
        self.time, self.folder = time, folder


class MissingExtraError(Learn2AssembleError, ImportError):
    """An optional dependency is not installed; the message names the extra that brings it, and
    ``package``, of which it is one."""

    def __init__(
        self, module: str, extra: str, without: str = "", package: str = "learn2assemble"
    ) -> None:
        self.module = module
        self.extra = extra
        self.without = without
        self.package = package
        are, them = ("are", "them") if " and " in module else ("is", "it")
        otherwise = f", or do without: {without}" if without else ""
        super().__init__(
            f"{module} {are} not installed; install {them} with: "
            f"pip install '{package}[{extra}]'{otherwise}"
        )

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str, str, str]]:
        return MissingExtraError, (self.module, self.extra, self.without, self.package)


def require(*needs: tuple[str, str, str]) -> None:
    """See that optional dependencies are there: the module of each, the extra that brings it, and
    the option that does without it, or nothing.

    Raises:
        MissingExtraError: one that names all of them that are missing.
    """
    missing: list[tuple[str, str, str]] = []
    for need in needs:
        try:
            importlib.import_module(need[0])
        except ImportError:
            missing.append(need)
    if missing:
        modules, extras, options = zip(*missing, strict=True)
        without = " ".join(options) if all(options) else ""
        raise MissingExtraError(" and ".join(modules), ",".join(dict.fromkeys(extras)), without)


@contextmanager
def extra(module: str, name: str, package: str = "learn2assemble") -> Generator[None, None, None]:
    """Imports that need the optional dependency ``name`` of a package.

    Raises:
        MissingExtraError: where one of them fails.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(module, name, package=package) from error


@contextmanager
def trusted(source: str, expected: str, how: str = "") -> Generator[None, None, None]:
    """Whatever a library raises about a damaged file, as one line."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  the libraries trust their input
        # What the library says, but not where in the memory the file is.
        told = re.sub(r"<[^<>]* at 0x[0-9a-f]+>", "it", str(error), flags=re.IGNORECASE)
        told = re.sub(r"^\w+(Error|Exception): ", "", " ".join(told.split())).rstrip(".")
        reason = f"{told or type(error).__name__} (while reading it{how})"
        raise InputError(source, reason, expected) from None


def listed(names: Sequence[object], most: int = 3) -> str:
    """Names in words, the first of them where there are more."""
    left = len(names) - most
    return ", ".join(map(str, names[:most])) + (f" and {left} more" if left > 0 else "")


def _short(value: object, limit: int = 120) -> str:
    if getattr(value, "shape", None) == () and (bare := getattr(value, "item", None)) is not None:
        value = bare()  # A number of NumPy is shown as one of Python.
    text = repr(value).replace("\n", " ")
    return text if len(text) <= limit else text[: limit - 1] + "…"


def one_line(error: BaseException) -> str:
    """The message of ``error`` on a single line, with its type where the message is empty."""
    text = " ".join(str(error).split())
    return text or type(error).__name__
