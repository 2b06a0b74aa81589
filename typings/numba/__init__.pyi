"""What is used of numba: a compiled function has the type of the function that is compiled."""

from collections.abc import Callable
from typing import Any, TypeVar, overload

_Function = TypeVar("_Function", bound=Callable[..., Any])

@overload
def njit(function: _Function, /) -> _Function: ...
@overload
def njit(*signatures: Any, **options: Any) -> Callable[[_Function], _Function]: ...
def __getattr__(name: str) -> Any: ...
