"""Tables of named values that code outside the package may add to."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

from learn2assemble.errors import InputError, UnknownNameError

T = TypeVar("T")
_PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
"""A name is also that of files, of environments and an argument of commands."""
PLAIN_NAME = "a word of letters, digits, '.', '_' and '-'"
_plugins: dict[str, list[str]] = {}
"""Modules that add values of a kind, and are not imported yet."""
_ELSEWHERE = " (a checkout of the source repository, with its laboratory, has more)"
_optional: set[str] = set()
"""Those of distributions that may be missing."""


def add_plugin(module: str, *kinds: str, optional: bool = False) -> None:
    """Name a module whose ``register_KIND(table)`` adds values to the tables of these kinds.

    It is imported only when a name is needed that its table does not hold yet, after those that
    were named before it, or when all names are listed.

    Args:
        optional: of a distribution that may be missing, which adds nothing then.
    """
    if optional:
        _optional.add(module)
    for kind in kinds:
        _plugins.setdefault(kind, []).append(module)


def is_plain_name(name: object) -> bool:
    """Whether it is :data:`PLAIN_NAME`, which begins with a letter or a digit."""
    return isinstance(name, str) and _PLAIN.fullmatch(name) is not None


class Registry(Mapping[str, T]):
    """Named values of one kind.

    Args:
        kind: what the values are, for error messages and plug-ins, e.g. ``"task"``.
        entries: the package's own.
        make: turns one of these into its value when it is asked for; without it they are values.
    """

    def __init__(
        self, kind: str, entries: Mapping[str, Any], make: Callable[[str, Any], T] | None = None
    ) -> None:
        self.kind = kind
        self._entries: dict[str, Any] = dict(entries)
        self._make = make
        self._unmade: set[str] = set(entries) if make else set()
        self._loading = False
        self.listeners: list[Callable[[str], None]] = []
        """Called with every name that is added."""
        self.elsewhere: str = ""
        """What a message about an unknown name adds where the distribution of others is missing."""

    def register(self, name: str, value: T, *, replace: bool = False) -> None:
        """Add ``value`` under ``name``.

        Raises:
            InputError: for a name that is no plain word, and for one that is taken, unless
                ``replace`` is given.
        """
        if not is_plain_name(name):
            raise InputError(f"{self.kind} name", name, PLAIN_NAME)
        if name in self and not replace:
            raise InputError(f"{self.kind} name", name, "a name that is not taken")
        self._entries[name] = value
        self._unmade.discard(name)
        for listener in self.listeners:
            listener(name)

    def _load_plugin(self) -> bool:
        """Import the next module that adds values; whether there was one."""
        modules = _plugins.get(self.kind)
        if not modules or self._loading:
            return False
        self._loading = True
        try:
            register = f"register_{self.kind.replace(' ', '_')}"
            module = modules.pop(0)
            if module in _optional and not importlib.util.find_spec(module.partition(".")[0]):
                self.elsewhere = _ELSEWHERE
            else:
                getattr(importlib.import_module(module), register)(self)
        finally:
            self._loading = False
        return True

    def _load_plugins(self) -> None:
        while self._load_plugin():
            pass

    def __getitem__(self, name: str) -> T:
        if name not in self:
            raise UnknownNameError(self.kind, name, self)
        if self._make is not None and name in self._unmade:
            self._entries[name] = self._make(name, self._entries[name])
            self._unmade.discard(name)
        return self._entries[name]

    def get(self, name: str, default: Any = None) -> Any:
        return self[name] if name in self else default  # noqa: SIM401

    def __contains__(self, name: object) -> bool:
        if not isinstance(name, str):
            return False
        while name not in self._entries:
            if not self._load_plugin():
                return False
        return True

    def __iter__(self) -> Iterator[str]:
        self._load_plugins()
        return iter(self._entries)

    def __len__(self) -> int:
        self._load_plugins()
        return len(self._entries)
