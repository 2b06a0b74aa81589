"""Agents that the package does not carry are fetched, the listed ones and nothing else."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest

import learn2assemble as l2a
from learn2assemble.errors import InputError, UnknownNameError
from learn2assemble.tasks.networks import agent as agents
from learn2assemble.tasks.networks import agent_fetch
from learn2assemble.tasks.networks.agent_fetch import ListedAgent, fetch_agents, listed_agents

ROOT = Path(__file__).resolve().parents[1]
NAME = "dqn-s0"


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of fetched agents, as of somebody who has no checkout."""
    monkeypatch.setattr(agents, "REPOSITORY", tmp_path / "no-checkout")
    monkeypatch.setenv(agent_fetch.PLACE, str(tmp_path / "fetched"))
    return tmp_path / "fetched"


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """A folder of a release with one agent."""
    folder = tmp_path / "release"
    folder.mkdir()
    shutil.copy(ROOT / "agents" / f"{NAME}.safetensors", folder)
    return folder


class Asked(SimpleHTTPRequestHandler):
    """A server of files that tells what it was asked for."""

    paths: ClassVar[list[str]] = []

    def log_message(self, format: str, *args: Any) -> None:
        Asked.paths.append(self.path)


@pytest.fixture
def address(release: Path) -> Iterator[str]:
    """The release on the loopback address."""
    Asked.paths.clear()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Asked, directory=str(release)))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()
    thread.join()


def test_the_list_is_that_of_the_checkout() -> None:
    files = {file.stem: ListedAgent.of(file) for file in (ROOT / "agents").glob("*.safetensors")}
    assert files
    assert listed_agents().agents == files
    text = (ROOT / "src" / "learn2assemble" / "pretrained" / "agents.json").read_text()
    assert listed_agents().text() == text


def test_an_agent_is_fetched_once_and_found_by_its_name(address: str, place: Path) -> None:
    assert NAME not in agents.agent_files()
    with pytest.raises(InputError, match=r"fetch it \(fetch_agents\)"):
        l2a.load_agent(NAME)
    told: list[str] = []
    (file,) = l2a.fetch_agents([NAME], address, progress=told.append)
    assert file == place / f"{NAME}.safetensors"
    assert file.read_bytes() == (ROOT / "agents" / file.name).read_bytes()
    assert l2a.load_agent(NAME).name == NAME
    assert told == [f"{NAME}: 0.3 MB"]
    assert Asked.paths == [f"/{NAME}.safetensors"]
    assert fetch_agents([NAME], address, progress=told.append) == [file]
    assert len(told) == len(Asked.paths) == 1, "what is there is not fetched again"


@pytest.mark.parametrize("change", [b"", b"x"], ids=["cut off", "changed"])
def test_another_file_is_refused_and_not_kept(
    change: bytes, release: Path, address: str, place: Path
) -> None:
    file = release / f"{NAME}.safetensors"
    file.write_bytes(file.read_bytes()[:-1] + change)
    for source in (release, address):
        with pytest.raises(InputError, match="the one of 270924 bytes"):
            fetch_agents([NAME], source)
    assert not place.exists()


def test_what_cannot_be_fetched_is_one_line(
    tmp_path: Path, release: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for source, words in {
        release: "No such file",
        tmp_path / "nosuch": "No such file",
        address: "Not Found|File not found",
        "http://127.0.0.1:1/": "refused",
    }.items():
        with pytest.raises(InputError, match=words) as caught:
            fetch_agents(["dqn-s1"], source)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no release carries them yet"):
        fetch_agents([NAME])
    with pytest.raises(UnknownNameError, match="dqn-s0"):
        fetch_agents(["dqn-so"], release)
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(agent_fetch.PLACE, str(blocked / "inside"))
    with pytest.raises(InputError, match=agent_fetch.PLACE):
        fetch_agents([NAME], release)
