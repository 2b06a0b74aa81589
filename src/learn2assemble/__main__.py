"""The program ``l2a``, also as ``python -m learn2assemble``."""

from __future__ import annotations

import os
import signal
import sys


def leave(*_: object) -> None:
    """End at once: before a command begins there is nothing to tidy up."""
    os.write(2, b"l2a: interrupted\n")
    os._exit(130)


def run() -> int:
    """Run ``l2a`` with the words of the command line; the exit code."""
    signal.signal(signal.SIGINT, leave)
    from learn2assemble.cli import main

    return main()


if __name__ == "__main__":
    sys.exit(run())
