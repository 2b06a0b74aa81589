"""Gymnasium environments: single and native vectorised, registered over the tasks.

Thin skins over :class:`learn2assemble.simulator.Simulator`: no rule of the world lives here.
Importing this package only registers names; the environments load when one is made.
"""

from learn2assemble.envs.registration import NAMESPACE, VERSION, env_id, register_all

__all__ = ["NAMESPACE", "VERSION", "env_id", "register_all"]
