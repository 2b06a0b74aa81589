"""The command line ``l2a``: a thin skin over the package."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

from learn2assemble.cli.output import Output
from learn2assemble.cli.parser import make_parser
from learn2assemble.errors import Learn2AssembleError, one_line
from learn2assemble.files import unwritable


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code.

    0: done. 1: the answer is no: a plan that is incomplete or refused (``build``), blocks that fall
    (``check``) or are out of reach (``reach``), another structure (``replay-trajectory``). 2: bad
    input, with one line on standard error. 130: interrupted.
    """
    try:
        options = make_parser().parse_args(arguments)
        # From here on an interrupt lets the command tidy up.
        signal.signal(signal.SIGINT, _interrupt)
        return int(options.run(options, Output(options.json)) or 0)
    except Learn2AssembleError as error:
        sys.stderr.write(f"l2a: error: {one_line(error)}\n")
        return 2
    except BrokenPipeError:
        # The reader of our output has left; there is nobody to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        where = unwritable("file", error.filename, error)
        sys.stderr.write(f"l2a: error: {one_line(where)}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("l2a: interrupted\n")
        return 130


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt the command, but no library that is being loaded: C++ code aborts the process at
    an exception it does not expect. Then again a moment later."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            threading.Timer(0.1, signal.raise_signal, [number]).start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt
