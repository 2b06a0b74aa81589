"""learn2assemble: from a target design to a verified build plan.

Every public name is here; it is loaded when it is used, so that importing the package takes no
time. Environments are registered with Gymnasium, at once or when that is imported.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from typing import TYPE_CHECKING, Any

from learn2assemble.registry import add_plugin

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

    from learn2assemble.assembly.blocks import Assembly, Block
    from learn2assemble.assembly.files import read_assembly
    from learn2assemble.assembly.kit import Kit, load_kit
    from learn2assemble.design.cells import CellDesign
    from learn2assemble.design.cells import read_design as load_design
    from learn2assemble.errors import InputError, Learn2AssembleError
    from learn2assemble.evaluation.episodes import Evaluation, evaluate
    from learn2assemble.export.formats import export_assembly
    from learn2assemble.export.robot_programs import export_program, replay_program
    from learn2assemble.learning.config import Learner, TrainConfig, register_learner
    from learn2assemble.learning.run import TrainingRun, train
    from learn2assemble.networks.agent import Agent, load_agent
    from learn2assemble.networks.config import NetworkConfig, register_network
    from learn2assemble.physics.rigid_blocks import Check, check
    from learn2assemble.planning.build import build, reach
    from learn2assemble.planning.plan import Plan, Step, load_plan
    from learn2assemble.robot.registry import register_arm, register_tool
    from learn2assemble.search.config import SearchConfig, register_search
    from learn2assemble.simulator import Simulator
    from learn2assemble.tasks import Task, get_task, register_task
    from learn2assemble.world.blocks import Shape, register_object_set

__version__ = "0.1.0"

_HOME = {
    "Agent": "networks.agent",
    "Assembly": "assembly.blocks",
    "Block": "assembly.blocks",
    "CellDesign": "design.cells",
    "Check": "physics.rigid_blocks",
    "Evaluation": "evaluation.episodes",
    "InputError": "errors",
    "Kit": "assembly.kit",
    "Learn2AssembleError": "errors",
    "Learner": "learning.config",
    "NetworkConfig": "networks.config",
    "Plan": "planning.plan",
    "SearchConfig": "search.config",
    "Shape": "world.blocks",
    "Simulator": "simulator",
    "Step": "planning.plan",
    "Task": "tasks",
    "TrainConfig": "learning.config",
    "TrainingRun": "learning.run",
    "build": "planning.build",
    "check": "physics.rigid_blocks",
    "evaluate": "evaluation.episodes",
    "export_assembly": "export.formats",
    "export_program": "export.robot_programs",
    "get_task": "tasks",
    "load_agent": "networks.agent",
    "load_design": "design.cells:read_design",
    "load_kit": "assembly.kit",
    "load_plan": "planning.plan",
    "reach": "planning.build",
    "read_assembly": "assembly.files",
    "register_arm": "robot.registry",
    "replay_program": "export.robot_programs",
    "register_learner": "learning.config",
    "register_network": "networks.config",
    "register_object_set": "world.blocks",
    "register_search": "search.config",
    "register_task": "tasks",
    "register_tool": "robot.registry",
    "train": "learning.run",
}
"""The module of every public name, and its name there where it is another one."""

__all__ = [
    "Agent",
    "Assembly",
    "Block",
    "CellDesign",
    "Check",
    "Evaluation",
    "InputError",
    "Kit",
    "Learn2AssembleError",
    "Learner",
    "NetworkConfig",
    "Plan",
    "SearchConfig",
    "Shape",
    "Simulator",
    "Step",
    "Task",
    "TrainConfig",
    "TrainingRun",
    "build",
    "check",
    "evaluate",
    "export_assembly",
    "export_program",
    "get_task",
    "load_agent",
    "load_design",
    "load_kit",
    "load_plan",
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
    "train",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, other = _HOME[name].partition(":")
    value = getattr(importlib.import_module(f"{__name__}.{module}"), other or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _AfterGymnasium:
    """Registers the environments as soon as Gymnasium has been imported, which takes longer than
    everything here."""

    @classmethod
    def find_spec(cls, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(cls)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: Any) -> None:
                execute(module)
                importlib.import_module(f"{__name__}.envs")

            spec.loader.exec_module = execute_and_register
        return spec


add_plugin("learn2assemble.reproduction", "physics", "search model")
add_plugin("learn2assemble.viewer", "export")
add_plugin("learn2assemble.export", "export")
if sys.modules.get("gymnasium") is None:
    sys.meta_path.insert(0, _AfterGymnasium)
else:
    importlib.import_module(f"{__name__}.envs")
