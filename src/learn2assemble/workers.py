"""Independent pieces of work on several processes or machines, each done exactly once.

A worker that dies takes nothing with it but the piece it was at, which another one does again.
"""

from __future__ import annotations

import importlib.util
import logging
import multiprocessing
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from learn2assemble.errors import InputError, Learn2AssembleError, MissingExtraError

Item = TypeVar("Item")
Found = TypeVar("Found")

MAX_DEATHS = 3
"""So many workers in a row may die without a piece of work being finished."""
CONNECT_SECONDS = 5.0
"""Within which the address of a cluster must answer."""
LOCAL = "local"
"""An address: a cluster of this machine alone, started for the work and stopped after it."""


class WorkerError(Learn2AssembleError, RuntimeError):
    """Workers die again and again."""


def run_all(
    function: Callable[[Item], Found],
    items: Sequence[Item],
    *,
    workers: int = 1,
    ray: str | None = None,
) -> Iterator[tuple[Item, Found]]:
    """Call ``function`` on every item; results as they come.

    Args:
        function: of a module, so that other processes find it; depends on its argument only.
        items: can be pickled.
        workers: processes; 1 works in this one.
        ray: address of a Ray cluster to work on instead, ``HOST:PORT`` of its head, ``auto`` for
            the one that runs on this machine, or ``local``. What items name as files must be found
            there under the same paths.

    Raises:
        InputError: for an address at which no cluster answers.
        MissingExtraError: for ``ray`` without the extra of that name.
        WorkerError: where workers die and nothing gets done any more.
    """
    if ray is not None:
        yield from _on_ray(function, items, ray, workers)
    elif workers <= 1 or len(items) <= 1:
        for item in items:
            yield item, function(item)
    else:
        yield from _on_processes(function, items, workers)


def _on_processes(
    function: Callable[[Item], Found], items: Sequence[Item], workers: int
) -> Iterator[tuple[Item, Found]]:
    left, deaths = list(range(len(items))), 0
    context = multiprocessing.get_context("spawn")
    while left:
        before = len(left)
        with ProcessPoolExecutor(min(workers, len(left)), context, _begin) as pool:
            try:
                futures = {pool.submit(function, items[n]): n for n in left}
                for future in as_completed(futures):
                    try:
                        found = future.result()
                    except BrokenProcessPool:
                        continue  # One worker died, and all that was not finished goes again.
                    left.remove(futures[future])
                    yield items[futures[future]], found
            except BaseException:
                for process in multiprocessing.active_children():
                    process.terminate()
                raise
        deaths = 0 if len(left) < before else deaths + 1
        if deaths >= MAX_DEATHS:
            text = f"workers died {deaths} times without finishing anything; {len(left)} left"
            raise WorkerError(text)


def _begin() -> None:
    """Of a worker: one thread, as small batches lose more by sharing than they gain; the parent
    answers Ctrl-C, and the worker ends where the parent was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _one_thread()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _one_thread() -> None:
    os.environ["OMP_NUM_THREADS"] = "1"
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def _on_ray(
    function: Callable[[Item], Found], items: Sequence[Item], address: str, workers: int
) -> Iterator[tuple[Item, Found]]:
    if importlib.util.find_spec("ray") is None:
        raise MissingExtraError("ray", "ray")
    host, _, port = address.rpartition(":")
    if address not in (LOCAL, "auto"):
        _check_answer(address, host, port)
    import ray
    import ray.exceptions

    library: Any = ray  # Its own types are known in part.
    started = not ray.is_initialized()
    if started:
        options: dict[str, Any] = {"address": address}
        if address == LOCAL:
            options = {"num_cpus": max(workers, 1), "include_dashboard": False}
        try:
            library.init(**options, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, RuntimeError, ValueError):
            raise InputError("ray", address, "the address of a Ray cluster") from None
    try:
        # Not retried by Ray itself after an exception of the function: those are answers.
        remote = library.remote(num_cpus=1, max_retries=MAX_DEATHS)(_on_node)
        waiting = {remote.remote(function, item): item for item in items}
        while waiting:
            ready, _ = library.wait(list(waiting))
            for reference in ready:
                try:
                    found = library.get(reference)
                except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError):
                    text = f"workers died {MAX_DEATHS} times at one piece of work"
                    raise WorkerError(text) from None
                except ray.exceptions.RayTaskError as error:
                    raise error.cause from None
                yield waiting.pop(reference), found
    finally:
        if started:
            library.shutdown()


def _on_node(function: Callable[[Item], Found], item: Item) -> Found:
    _one_thread()
    return function(item)


def _check_answer(address: str, host: str, port: str) -> None:
    """Refuse an address at once where nothing listens; Ray would try for a minute."""
    expected = f"HOST:PORT of a Ray cluster that answers, auto or {LOCAL}"
    try:
        socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    except (OSError, ValueError, OverflowError):
        raise InputError("ray", address, expected) from None
