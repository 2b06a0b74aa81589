"""What is used of it: the files of a cache, and the cache of one function."""

from typing import Any

class CompileResultCacheImpl:
    locator: Any
    def get_filename_base(self, fullname: str, abiflags: str) -> str: ...

class FunctionCache:
    _cache_file: Any
    _py_func: Any
    def __init__(self, py_func: Any) -> None: ...
    def load_overload(self, sig: Any, target_context: Any) -> Any: ...
    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]: ...
