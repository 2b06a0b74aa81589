"""Compiled functions, kept on the disk until anything changes that they are compiled from.

The machine code of a function holds that of all it calls and the values it reads. Numba keeps it as
long as the function's own file is the same: after a change elsewhere old results would come.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from functools import cached_property, partial
from types import CodeType, ModuleType
from typing import Any, TypeVar, cast, overload

import numpy as np
from numba import njit, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _KernelFiles(CompileResultCacheImpl):
    """Files without the number of a line in their names: what moved replaces what it was."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        line = f"-{self.locator.get_disambiguator()}.py"
        return super().get_filename_base(fullname, abiflags).replace(line, ".py")


class _KernelCache(FunctionCache):
    """A cache whose stamp is of the files of all kernels that are reached, as they were imported,
    and of the values they read: where it differs, numba compiles anew in place of what was kept."""

    _impl_class = _KernelFiles

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self.own: object = self._cache_file._source_stamp
        load: Callable[[], dict[Any, Any]] = self._cache_file._load_index

        def load_index() -> dict[Any, Any]:
            """What is kept; nothing where it names a class that is called otherwise by now."""
            try:
                return load()
            except (AttributeError, ImportError):
                return {}

        self._cache_file._load_index = load_index

    @cached_property
    def read(self) -> tuple[dict[str, object], list[_KernelCache]]:
        """Values that the function itself reads, and caches of what it calls.

        They are looked up when it is first called: it may call one that stands below it.
        """
        function: Any = self._py_func
        values: dict[str, object] = {f"{function.__module__}.{function.__qualname__}": self.own}
        called: list[_KernelCache] = []
        codes, names = [function.__code__], set[str]()
        for code in codes:
            names.update(code.co_names)
            codes += [inner for inner in code.co_consts if isinstance(inner, CodeType)]

        def add(name: str, value: Any, deep: bool = False) -> None:
            cache = getattr(value, "_cache", None)
            if isinstance(cache, _KernelCache):
                called.append(cache)
            elif isinstance(value, np.ndarray):
                array = cast("np.ndarray", value)
                values[name] = array.dtype.str, array.shape, array.tobytes()
            elif isinstance(value, tuple):
                for i, part in enumerate(cast("tuple[Any, ...]", value)):
                    add(f"{name}[{i}]", part)
            elif isinstance(value, int | float | complex | str | np.generic):
                values[name] = repr(cast("object", value))
            elif deep and isinstance(value, ModuleType | type):
                values[name] = getattr(value, "_fields", None)
                get = vars(value).get if isinstance(value, ModuleType) else partial(getattr, value)
                for inner in names:
                    add(f"{name}.{inner}", get(inner, None))

        for name, cell in zip(codes[0].co_freevars, function.__closure__ or (), strict=True):
            add(name, cell.cell_contents, deep=True)
        for name in names:
            add(name, function.__globals__.get(name), deep=True)
        return values, called

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        reached = [self]
        for cache in reached:
            reached += [called for called in cache.read[1] if called not in reached]
        text = repr(sorted(repr(sorted(cache.read[0].items())) for cache in reached))
        self._cache_file._source_stamp = hashlib.sha256(text.encode()).hexdigest()
        return super().load_overload(sig, target_context)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        line = self._py_func.__code__.co_firstlineno
        return *super()._index_key(sig, codegen), line, repr(_fields(getattr(sig, "args", sig)))


def _fields(kinds: Iterable[Any]) -> list[Any]:
    """Fields of the named tuples among types: numba knows these by class and types of fields."""
    tuples = [kind for kind in kinds if isinstance(kind, types.BaseTuple)]
    return [(getattr(kind, "fields", ()), _fields(getattr(kind, "types", ()))) for kind in tuples]


@overload
def kernel(function: _Function, /) -> _Function: ...
@overload
def kernel(**options: Any) -> Callable[[_Function], _Function]: ...
def kernel(function: Any = None, /, **options: Any) -> Any:
    """A function that is compiled when it is first called, and kept on the disk.

    Args:
        function: of numbers and arrays, as numba compiles them.
        options: of ``numba.njit``.
    """
    if function is None:
        return partial(kernel, **options)
    compiled: Any = njit(**options)(function)
    compiled._cache = _KernelCache(function)
    return compiled
