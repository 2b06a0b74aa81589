"""The program ``l2a``, also as ``python -m learn2assemble``."""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130
"""Exit code of a program that a signal has ended: 128 and the number of the signal."""


def leave(*_: object) -> None:
    """End at once: before a command begins there is nothing to tidy up."""
    os.write(2, b"l2a: interrupted\n")
    os._exit(INTERRUPTED)


def run() -> int:
    """Run ``l2a`` with the words of the command line; the exit code."""
    signal.signal(signal.SIGINT, leave)
    from learn2assemble.cli import main

    code = main()
    if code == INTERRUPTED:
        # What an interrupt left half made may fail as Python ends: nobody is to hear of it.
        sys.unraisablehook = lambda _: None
    return code


if __name__ == "__main__":
    sys.exit(run())
