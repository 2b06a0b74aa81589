"""learn2assemble: from a target design to a verified build plan.

Importing the package registers its environments with Gymnasium where that is installed; the
training path needs neither Gymnasium nor MuJoCo.
"""

from __future__ import annotations

import importlib.util

from learn2assemble.registry import add_plugin

__version__ = "0.1.0"

add_plugin("learn2assemble.reproduction", "physics")
add_plugin("learn2assemble.viewer", "export")

if importlib.util.find_spec("gymnasium") is not None:
    from learn2assemble.envs import register_all

    register_all()
