"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from headless import find_browser
from make_recordings import REFERENCE, unpack

# The same examples on every machine, however slow it is; `pytest -m hypothesis
# --hypothesis-profile=default` looks for others.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# What somebody has fetched on this machine changes no test.
os.environ["LEARN2ASSEMBLE_AGENTS"] = str(Path(__file__).parent / "out" / "no-agents")


PARTS = "product", "tasks", "laboratory"
TASKS = re.compile(r"^ *(from|import) (learn2assemble\.(tasks|envs)|learning_data)\b", re.MULTILINE)
"""What a test imports that is of the wing of the paper."""


@cache
def part_of(path: Path) -> str:
    """The part that the tests of a file are of: tests that import tasks are of those."""
    if "laboratory" in path.parts:
        return "laboratory"
    return "tasks" if TASKS.search(path.read_text(encoding="utf-8")) else "product"


def pytest_configure(config: pytest.Config) -> None:
    """The order of the tests is random; numbers drawn in them are theirs."""
    config.option.randomly_reset_seed = False


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what repeats the order of the tests."""
    seed = terminalreporter.config.getoption("randomly_seed", None)
    if seed is not None:
        terminalreporter.write_line(f"order of the tests: --randomly-seed={seed}")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Of one part that is asked for alone no file of another one is loaded: the product is tested
    without PyTorch and without the laboratory (``pytest -m product``)."""
    asked = (config.getoption("markexpr") or "").split(" and ")
    if collection_path.suffix != ".py" or len({*asked} & {*PARTS}) != 1 or " or " in str(asked):
        return None
    return part_of(collection_path) not in asked or None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Every test is of one part: the product, the tasks of the paper, the laboratory.

    The plug-in that puts them into a random order does it before this.
    """
    for item in items:
        item.add_marker(part_of(item.path))
    # Long ones come first: none is begun when the other processes are out of work.
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of what the published simulator was recorded to do: all of it where it is present,
    else the part in ``tests/data``."""
    if REFERENCE.is_dir():
        return REFERENCE
    folder = tmp_path_factory.mktemp("recordings")
    unpack(folder)
    return folder


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the project's own test data."""
    return Path(__file__).parent / "tests" / "data"


@pytest.fixture
def torch_as_before() -> Iterator[None]:
    """What scripts say of PyTorch, which are run in this process, holds for them alone: threads,
    and the seed of its generator."""
    import torch

    threads, state = torch.get_num_threads(), torch.get_rng_state()
    yield
    torch.set_num_threads(threads)
    torch.set_rng_state(state)


@pytest.fixture(scope="session")
def browser() -> str:
    return find_browser()
