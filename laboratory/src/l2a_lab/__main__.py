"""The program ``l2a-lab``: what measures the package and remakes its tables and agents."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from learn2assemble.cli.parser import CommandLine


def command_line() -> CommandLine:
    """The program with its commands."""
    from learn2assemble.cli.parser import LABORATORY, CommandLine

    about = "Measure learn2assemble, and remake its tables and agents."
    return CommandLine("l2a-lab", about, "l2a-lab table T2", LABORATORY)


def run() -> int:
    """Run ``l2a-lab`` with the words of the command line; the exit code."""
    from learn2assemble.cli import main

    return main(None, command_line())


if __name__ == "__main__":
    sys.exit(run())
