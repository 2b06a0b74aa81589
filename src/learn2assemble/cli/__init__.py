"""The command line ``l2a``: a thin skin over the package."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from types import FrameType
from typing import Any

from learn2assemble.cli.output import Heartbeat, Output
from learn2assemble.cli.parser import L2A, CommandLine, make_parser
from learn2assemble.errors import InputError, Learn2AssembleError, one_line, printable, require


def main(arguments: Sequence[str] | None = None, program: CommandLine = L2A) -> int:
    """Run one command of a program; returns the exit code.

    0: done. 1: the answer is no: a plan that is incomplete or refused (``build``), blocks that fall
    (``check``) or are out of reach (``reach``), another structure (``replay-trajectory``). 2: bad
    input, with one line on standard error. 130: interrupted.
    """
    report = sys.unraisablehook
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # What it has no letters for is escaped.
            stream.reconfigure(errors="backslashreplace")
    try:
        words = sys.argv[1:] if arguments is None else arguments
        _check_words(words)
        options = make_parser(words, program).parse_args(words)
        # From here on an interrupt lets the command tidy up.
        sys.unraisablehook = partial(_unraisable, report)
        signal.signal(signal.SIGINT, _interrupt)
        seconds = getattr(options, "seconds", None) or 60 * (getattr(options, "minutes", None) or 0)
        with Heartbeat("working", seconds or None) as heartbeat:
            if options.learns:
                require(("torch", "learn", ""))
            code = int(options.run(options, Output(options.json, heartbeat, options.verbose)) or 0)
        sys.stdout.flush()
        return code
    except InputError as error:
        sys.stderr.write(f"{program.name}: error: {' '.join(error.for_command_line().split())}\n")
        return 2
    except Learn2AssembleError as error:
        sys.stderr.write(f"{program.name}: error: {one_line(error)}\n")
        return 2
    except BrokenPipeError:
        # The reader of our output has left; there is nobody to tell.
        _drop_output()
        return 0
    except OSError as error:
        if error.filename is None and error.errno not in _FULL:
            raise
        name, reason = error.filename or "output", error.strerror or type(error).__name__
        expected = f"a file that can be read or written ({reason})"
        where = InputError("file", printable(os.fsdecode(name)), expected)
        sys.stderr.write(f"{program.name}: error: {one_line(where)}\n")
        _drop_output()
        return 2
    except KeyboardInterrupt:
        sys.stderr.write(f"{program.name}: interrupted\n")
        return 130
    finally:
        sys.unraisablehook = report


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""What a disk or a device says that takes no more; such errors need not name a file."""


def _check_words(words: Sequence[str]) -> None:
    """Refuse words that are not UTF-8, such as names of files of other systems: they could not be
    written into any of our files; and a zero byte, which no name of a file has.

    Raises:
        InputError: showing the word.
    """
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            raise InputError("argument", word, "UTF-8; rename the file") from None
        if "\0" in word:
            raise InputError("argument", word, "a word without a zero byte")


def _drop_output() -> None:
    """What is left of our output goes nowhere, so that Python does not try again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Interrupt the command, but no library that is being loaded: C++ code aborts the process at
    an exception it does not expect. Then again a moment later."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            _interrupt_later()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _unraisable(report: Callable[[Any], Any], unraisable: sys.UnraisableHookArgs) -> None:
    """Where Python drops an exception: a callback of a compiler cannot pass an interrupt on. Then
    again a moment later."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _interrupt_later()
    else:
        report(unraisable)


def _interrupt_later() -> None:
    def send() -> None:
        # Of the threads the main one, which may be waiting by then; Windows has no such signals.
        if sys.platform == "win32":
            signal.raise_signal(signal.SIGINT)
        else:
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    threading.Timer(0.1, send).start()
