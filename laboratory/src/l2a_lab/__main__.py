"""The program ``l2a-lab``: what measures the package and remakes its tables and agents."""

from __future__ import annotations

import sys


def run() -> int:
    """Run ``l2a-lab`` with the words of the command line; the exit code."""
    from l2a_lab.commands import register_command
    from learn2assemble.cli import main
    from learn2assemble.cli.parser import Command, CommandLine
    from learn2assemble.registry import Registry

    commands: Registry[Command] = Registry("laboratory command", {})
    register_command(commands)
    about = "Measure learn2assemble, and remake its tables and agents."
    return main(None, CommandLine("l2a-lab", about, "l2a-lab table T2", commands))


if __name__ == "__main__":
    sys.exit(run())
