"""The program ``l2a``, also as ``python -m learn2assemble``."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn

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
        end(code)
    return code


def end(code: int) -> NoReturn:
    """End at once with what has been written: libraries that an interrupt met half way may fail,
    or crash, as Python tidies up."""
    with suppress(OSError):  # Whoever reads may have gone.
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    sys.exit(run())
