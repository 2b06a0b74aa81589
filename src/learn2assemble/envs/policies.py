"""Policies of the benchmark: the baselines by name, those of a user's file, and one that answers
from another process.

A policy in another process listens on a loopback address and answers every line of JSON,
``{"task": ..., "observation": {...}, "info": {...}}``, where masks are lists of the numbers that
they allow, with a line ``{"action": 7}``.
"""

from __future__ import annotations

import importlib
import importlib.util
import ipaddress
import json
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np

from learn2assemble.envs.assembly import AssemblyEnv
from learn2assemble.envs.candidate_policies import (
    DesignLookahead,
    ExactPlanner,
    GoalsLookahead,
)
from learn2assemble.envs.designs import DesignEnv, GoalsEnv
from learn2assemble.envs.hidden import HiddenEnv
from learn2assemble.envs.hidden_policies import (
    HiddenLookahead,
    PlannerWithoutLooks,
    RepairingPlanner,
)
from learn2assemble.envs.suite import SECONDS, Choose
from learn2assemble.errors import InputError, check_name
from learn2assemble.registry import Registry, add_plugin
from learn2assemble.tasks.graph.features import node_offset
from learn2assemble.tasks.graph.placements import distinct_placements, locate
from learn2assemble.tasks.networks.agent import default_agent, load_agent
from learn2assemble.tasks.simulator import Simulator
from learn2assemble.tasks.world.state import State
from learn2assemble.tasks.world_model import WorldModel, lookahead_actions

_OFFERED = ("candidates", "placements", "mask")
"""Parts of an observation with a row for every action."""


class RandomChoice:
    """A uniform legal action always, drawn from a seed that runs through all problems."""

    def __init__(self, seed: int = 0) -> None:
        self.rng: np.random.Generator = np.random.default_rng(seed)

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        return int(self.rng.choice(np.flatnonzero(info["action_masks"])))


class OnStates:
    """Chooses actions of the states of a task of the paper.

    Args:
        choose: of a simulator and a state the local indices int64[1, 3] of an action.
        knows: ``model`` or ``observation``, see :data:`~.suite.Choose`.

    Raises:
        InputError: for another task.
    """

    env: AssemblyEnv

    def __init__(self, choose: Callable[[Simulator, State], np.ndarray], knows: str) -> None:
        self.choose = choose
        self.knows = knows

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem."""
        if not isinstance(env, AssemblyEnv):
            name = getattr(getattr(env, "task", None), "name", "?")
            raise InputError("task", name, "a task of placements: two-sided-* or robot-*")
        self.env = env

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        simulator, state = self.env.simulator, self.env.state.copy()
        graph, spec = simulator.observe(state), simulator.action_spec
        action = self.choose(simulator, state) + node_offset(graph)
        return int(locate(distinct_placements(graph, spec), graph, action, spec)[0])


class Lookahead:
    """The exact one-step look-ahead: of placements, see :mod:`learn2assemble.tasks.world_model`,
    of candidates of a design or to goals, or of given blocks."""

    knows = "model"

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem."""
        own = (make for kind, make in _AHEAD.items() if isinstance(env, kind))
        self.choose: Any = next(own, _of_states)()
        self.choose.begin(env)

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        return self.choose(observation, info)


def _of_states() -> OnStates:
    return OnStates(lookahead_actions, "model")


_AHEAD: dict[type[gymnasium.Env[Any, Any]], Callable[[], Any]] = {
    HiddenEnv: HiddenLookahead,
    DesignEnv: DesignLookahead,
    GoalsEnv: GoalsLookahead,
}
"""The look-ahead of each environment but those of placements."""


def trained_agent(agent: str | Path | None = None) -> OnStates:
    """An agent, greedy and without a search.

    Args:
        agent: by name or file; None takes the one that is shipped for the task.

    Raises:
        InputError: for an agent that is not there.
    """
    models: dict[str, WorldModel] = {}
    network = None if agent is None else load_agent(agent).network

    def best(simulator: Simulator, state: State) -> np.ndarray:
        name = simulator.task.name
        if name not in models:
            own = load_agent(default_agent(name)).network if network is None else network
            models[name] = WorldModel(simulator, own)
        return models[name].best(state)[1]

    return OnStates(best, "observation")


BASELINES: dict[str, Callable[[], Choose]] = {
    "random": RandomChoice,
    "look-ahead": Lookahead,
    "exact-planner": ExactPlanner,
    "planner-with-repair": RepairingPlanner,
    "planner-without-looks": PlannerWithoutLooks,
    "shipped": trained_agent,
}
"""Policies that come with the package, by name."""


def _random(seed: str) -> RandomChoice:
    if not seed.isdecimal():
        raise InputError("policy", f"random:{seed}", "random:SEED, a whole number of at least 0")
    return RandomChoice(int(seed))


NAMED: Registry[Callable[[str], Choose]] = Registry(
    "policy", {"agent": trained_agent, "random": _random}
)
"""Policies of which there are several, by what stands before the colon; the laboratory adds its
own where it is installed."""
add_plugin("l2a_lab.builder", "policy", optional=True)


def load_policy(where: str) -> Choose:
    """A policy by the name of a baseline, ``random:SEED``, ``agent:NAME``, ``package.module:name``
    or ``file.py:name``.

    A class is called without arguments; anything else that can be called is the policy.

    Raises:
        InputError: for what is not there, or cannot be called.
    """
    place, colon, name = where.rpartition(":")
    if not colon:
        check_name("policy", where, BASELINES)
        return BASELINES[where]()
    if place in NAMED:
        return NAMED[place](name)
    try:
        if place.endswith(".py"):
            spec = importlib.util.spec_from_file_location(Path(place).stem, place)
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
    except (ImportError, OSError, SyntaxError) as error:
        raise InputError("policy", where, f"a module that loads ({error})") from None
    found = getattr(module, name, None)
    policy: Any = found() if isinstance(found, type) else found
    if not callable(policy):
        raise InputError("policy", where, f"a name of {place} that can be called")
    return cast("Choose", policy)


class RemoteChoice:
    """A policy in another process, see the module.

    Args:
        address: ``HOST:PORT``, on this machine.

    Raises:
        InputError: for an address of another machine, and where nobody answers.
    """

    knows = "observation"

    def __init__(self, address: str) -> None:
        self.address = address
        self.task: str = ""
        host, _, port = address.rpartition(":")
        host = host.strip("[]")
        try:
            local = host == "localhost" or ipaddress.ip_address(host).is_loopback
        except ValueError:
            local = False
        if not local or not port.isdecimal() or not 0 < int(port) < 65536:
            raise InputError("server", address, "HOST:PORT of this machine, as 127.0.0.1:5000")
        try:
            self._socket = socket.create_connection((host, int(port)), SECONDS)
        except OSError as error:
            raise InputError("server", address, f"a policy that listens ({error})") from None
        self._lines = self._socket.makefile("rwb")

    def begin(self, env: gymnasium.Env[Any, Any]) -> None:
        """A new problem."""
        self.task = getattr(getattr(env, "task", None), "name", "")

    def __call__(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> int:
        masks = {k: np.flatnonzero(v) for k, v in info.items() if k.endswith(("mask", "masks"))}
        # What is offered comes first in every space of the suite; its padding is left out.
        used = len(masks["action_masks"])
        seen = {k: v[:used] if k in _OFFERED else v for k, v in observation.items()}
        said = {"task": self.task, "observation": seen, "info": {**info, **masks}}
        try:
            self._lines.write(json.dumps(said, default=_plain).encode() + b"\n")
            self._lines.flush()
            line = self._lines.readline(10**6)
            return json.loads(line)["action"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            what = f'a line {{"action": 7}} ({type(error).__name__})'
            raise InputError("answer of the server", self.address, what) from None

    def close(self) -> None:
        """End the connection."""
        self._lines.close()
        self._socket.close()


def _plain(value: Any) -> Any:
    return value.tolist()  # numbers of NumPy have it, too
