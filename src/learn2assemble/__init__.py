"""learn2assemble: from a target design to a verified build plan.

Every public name is here; it is loaded when it is used, so that importing the package takes no
time. Names of agents, their training and evaluation need the extra ``learn``. Environments are
registered with Gymnasium by ``import learn2assemble.envs``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from learn2assemble.registry import add_plugin

if TYPE_CHECKING:
    from learn2assemble.acting.calibrate import calibrate
    from learn2assemble.assembly.blocks import Assembly, AssemblyStep, Block, hull_block
    from learn2assemble.assembly.boxes import box_block
    from learn2assemble.assembly.files import read_assembly, write_assembly
    from learn2assemble.assembly.hands import Hand
    from learn2assemble.assembly.kit import Kind, Kit, load_kit
    from learn2assemble.cell.site import Site
    from learn2assemble.design.cells import CellDesign
    from learn2assemble.design.goals import Goals
    from learn2assemble.design.goals import read_goals as load_goals
    from learn2assemble.design.read import read_design as load_design
    from learn2assemble.envs.assembly import AssemblyEnv, AssemblyVectorEnv
    from learn2assemble.envs.demonstrations import Demonstrated, demonstrate
    from learn2assemble.errors import InputError, Learn2AssembleError
    from learn2assemble.export.formats import export_assembly
    from learn2assemble.export.robot_programs import export_program, replay_program
    from learn2assemble.jobs.build import build, reach
    from learn2assemble.jobs.run import Ran, run
    from learn2assemble.planning.plan import Plan, Step, load_plan
    from learn2assemble.plants.setup import Surroundings
    from learn2assemble.robot.arm import get_arm
    from learn2assemble.robot.registry import register_arm, register_tool
    from learn2assemble.statics.rigid_blocks import Check, check
    from learn2assemble.tasks.evaluation.episodes import Evaluation, evaluate
    from learn2assemble.tasks.learning.config import Learner, TrainConfig, register_learner
    from learn2assemble.tasks.learning.run import TrainingRun, train
    from learn2assemble.tasks.networks.agent import Agent, load_agent
    from learn2assemble.tasks.networks.agent_fetch import fetch_agents
    from learn2assemble.tasks.networks.config import NetworkConfig, register_network
    from learn2assemble.tasks.search.config import SearchConfig, register_search
    from learn2assemble.tasks.simulator import Simulator
    from learn2assemble.tasks.task import Task, get_task, register_task
    from learn2assemble.tasks.world.blocks import Shape, register_object_set
    from learn2assemble.viewer.preview import preview

__version__ = "0.1.0"

_HOME = {
    "assembly.blocks": "Assembly AssemblyStep Block hull_block",
    "assembly.boxes": "box_block",
    "assembly.hands": "Hand",
    "assembly.files": "read_assembly write_assembly",
    "assembly.kit": "Kind Kit load_kit",
    "design.cells": "CellDesign",
    "design.read": "load_design=read_design",
    "design.goals": "Goals load_goals=read_goals",
    "envs.assembly": "AssemblyEnv AssemblyVectorEnv",
    "envs.demonstrations": "Demonstrated demonstrate",
    "errors": "InputError Learn2AssembleError",
    "tasks.evaluation.episodes": "Evaluation evaluate",
    "export.formats": "export_assembly",
    "export.robot_programs": "export_program replay_program",
    "tasks.learning.config": "Learner TrainConfig register_learner",
    "tasks.learning.run": "TrainingRun train",
    "tasks.networks.agent": "Agent load_agent",
    "tasks.networks.agent_fetch": "fetch_agents",
    "tasks.networks.config": "NetworkConfig register_network",
    "statics.rigid_blocks": "Check check",
    "jobs.build": "build reach",
    "jobs.run": "Ran run",
    "plants.setup": "Surroundings",
    "planning.plan": "Plan Step load_plan",
    "acting.calibrate": "calibrate",
    "cell.site": "Site",
    "robot.arm": "get_arm",
    "robot.registry": "register_arm register_tool",
    "tasks.search.config": "SearchConfig register_search",
    "tasks.simulator": "Simulator",
    "tasks.task": "Task get_task register_task",
    "viewer.preview": "preview",
    "tasks.world.blocks": "Shape register_object_set",
}
"""The public names of every module; with its name there where that is another one."""
_PLACES = {
    public: (module, name or public)
    for module, names in _HOME.items()
    for public, _, name in (told.partition("=") for told in names.split())
}

__all__ = [
    "Agent",
    "Assembly",
    "AssemblyEnv",
    "AssemblyStep",
    "AssemblyVectorEnv",
    "Block",
    "CellDesign",
    "Check",
    "Demonstrated",
    "Evaluation",
    "Goals",
    "Hand",
    "InputError",
    "Kind",
    "Kit",
    "Learn2AssembleError",
    "Learner",
    "NetworkConfig",
    "Plan",
    "Ran",
    "SearchConfig",
    "Shape",
    "Simulator",
    "Site",
    "Step",
    "Surroundings",
    "Task",
    "TrainConfig",
    "TrainingRun",
    "box_block",
    "build",
    "calibrate",
    "check",
    "demonstrate",
    "evaluate",
    "export_assembly",
    "export_program",
    "fetch_agents",
    "get_arm",
    "get_task",
    "hull_block",
    "load_agent",
    "load_design",
    "load_goals",
    "load_kit",
    "load_plan",
    "preview",
    "reach",
    "read_assembly",
    "register_arm",
    "register_learner",
    "register_network",
    "register_object_set",
    "register_search",
    "register_task",
    "register_tool",
    "replay_program",
    "run",
    "train",
    "write_assembly",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, there = _PLACES[name]
    value = getattr(importlib.import_module(f"{__name__}.{module}"), there)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """What completion shows: the public names, and what every module has."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


add_plugin("l2a_lab", "physics", "search model", optional=True)
add_plugin("learn2assemble.viewer", "export")
add_plugin("learn2assemble.export", "export")
add_plugin("learn2assemble.controllers", "plant")
