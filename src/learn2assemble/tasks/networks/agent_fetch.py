"""Agents that no wheel carries: which there are, and how they are fetched.

The package lists them, with size and hash, in ``pretrained/agents.json``: {"release": address or
null, "agents": {name: {"bytes": n, "sha256": hash}}}. A release carries their files in one folder,
and ``release`` is its address; a checkout has them in ``agents/``.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple
from urllib.error import URLError
from urllib.parse import quote, urlsplit
from urllib.request import urlopen

from learn2assemble.errors import InputError, look_up
from learn2assemble.files import make_folder, write_file

LIST = "agents.json"
ENDING = ".safetensors"
PLACE = "LEARN2ASSEMBLE_AGENTS"
"""The variable of the environment that names the folder of fetched agents."""
PATIENCE = 30.0
"""A server that says nothing for so long [s] is given up."""


class ListedAgent(NamedTuple):
    """The file of an agent."""

    bytes: int
    sha256: str

    def __str__(self) -> str:
        return f"{self.bytes} bytes with the SHA-256 {self.sha256}"

    @classmethod
    def of(cls, file: Path) -> ListedAgent:
        """What a file is."""
        content = file.read_bytes()
        return cls(len(content), hashlib.sha256(content).hexdigest())


class AgentList(NamedTuple):
    """What ``agents.json`` says."""

    release: str | None
    agents: dict[str, ListedAgent]

    def text(self) -> str:
        """The file."""
        agents = {name: self.agents[name]._asdict() for name in sorted(self.agents)}
        return json.dumps({"release": self.release, "agents": agents}, indent=1) + "\n"


@cache
def listed_agents() -> AgentList:
    """The agents that can be fetched."""
    file = resources.files("learn2assemble") / "pretrained" / LIST
    told = json.loads(file.read_text(encoding="utf-8"))
    agents = {name: ListedAgent(**one) for name, one in told["agents"].items()}
    return AgentList(told["release"], agents)


def fetched_folder() -> Path:
    """Where fetched agents are kept: the folder that :data:`PLACE` names, else that of the caches
    of this user."""
    named = os.environ.get(PLACE)
    if named:
        return Path(named).expanduser()
    caches = os.environ.get("LOCALAPPDATA") or os.environ.get("XDG_CACHE_HOME")
    return (Path(caches) if caches else Path.home() / ".cache") / "learn2assemble" / "agents"


def fetch_agents(
    names: Iterable[str] = (),
    source: str | Path | None = None,
    *,
    progress: Callable[[str], object] | None = None,
) -> list[Path]:
    """Fetch agents that the package does not carry, so that they are found by name.

    A file that is there and is the listed one is left alone; one that is not the listed one is
    refused, and nothing is written.

    Args:
        names: which; without any, all that are listed.
        source: the folder that holds them, or its address (``http://`` or ``https://``); the
            address of the release without it.
        progress: is told of every agent.

    Returns:
        Their files, in the order of the names.

    Raises:
        UnknownNameError: for a name that is not listed.
        InputError: where there is no source, it does not answer, or it holds another file.
    """
    known = listed_agents()
    wanted = {name: look_up("agent", name, known.agents) for name in names} or known.agents
    origin = known.release if source is None else str(source)
    if origin is None:
        raise InputError(
            "source of agents",
            "none",
            "a folder or an address, as no release carries them yet; a checkout has them in agents",
        )
    folder, files = fetched_folder(), list[Path]()
    for name, told in wanted.items():
        file = folder / f"{name}{ENDING}"
        if not (file.is_file() and ListedAgent.of(file) == told):
            content = _content(origin, file.name, told.bytes)
            if hashlib.sha256(content).hexdigest() != told.sha256:
                raise InputError("agent", f"another {file.name} of {origin}", f"the one of {told}")
            make_folder(file.parent, PLACE)
            write_file(file, content, "agent")
            if progress is not None:
                progress(f"{name}: {len(content) / 1e6:.1f} MB")
        files.append(file)
    return files


def _content(origin: str, name: str, size: int) -> bytes:
    """A file of a folder or of an address; of one that is too long a byte more than ``size``."""
    try:
        if urlsplit(origin).scheme in ("http", "https"):
            with urlopen(f"{origin.rstrip('/')}/{quote(name)}", timeout=PATIENCE) as stream:
                return stream.read(size + 1)
        with (Path(origin).expanduser() / name).open("rb") as stream:
            return stream.read(size + 1)
    except (OSError, ValueError) as error:  # URLError is an OSError.
        reason = error.reason if isinstance(error, URLError) else error
        words = getattr(reason, "strerror", None) or " ".join(str(reason).split())
        raise InputError("agent", f"{name} of {origin}", f"a file there ({words})") from None
