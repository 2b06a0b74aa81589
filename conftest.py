"""Fixtures shared by all tests."""

from __future__ import annotations

import os
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


TASKS = "learn2assemble.tasks", "learn2assemble.envs", "learning_data"
"""What a test imports that is of the wing of the paper."""


def pytest_configure(config: pytest.Config) -> None:
    """The order of the tests is random; numbers drawn in them are theirs."""
    config.option.randomly_reset_seed = False


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what repeats the order of the tests."""
    seed = terminalreporter.config.getoption("randomly_seed", None)
    if seed is not None:
        terminalreporter.write_line(f"order of the tests: --randomly-seed={seed}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Every test is of one part: the product, the tasks of the paper, the laboratory.

    The plug-in that puts them into a random order does it before this.
    """
    part: dict[Path, str] = {}
    for item in items:
        if item.path not in part:
            text = item.path.read_text(encoding="utf-8")
            of_tasks = any(name in text for name in TASKS)
            lab = "laboratory" in item.path.parts
            part[item.path] = "laboratory" if lab else "tasks" if of_tasks else "product"
        item.add_marker(part[item.path])
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


@pytest.fixture(scope="session")
def browser() -> str:
    return find_browser()
