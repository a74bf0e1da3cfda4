"""Exit codes of the command line, and its last words. Bad input gets one line, a fault of coview its traceback."""

from __future__ import annotations

import os
import sys
import traceback
from contextlib import suppress

from toolkit.runtime.parallel import WorkLost

OK, SUSPECTED, BAD_INPUT, MISSING, LOST, INTERNAL, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 4, 70, 130, 141
NOT_MET = SUSPECTED  # a plan's requirement cannot be met; "no", like a suspicion of the doctor
OURS = ("coview", "placement_env", "models", "toolkit")
REPORT = "this is a fault of coview, not of what you gave it: please report it with the lines above"


def report(error: BaseException, *, debug: bool = False) -> int:
    """Print an error on stderr and return its exit code. debug: print the traceback of any error."""
    if isinstance(error, BrokenPipeError):
        with suppress(OSError, ValueError):  # stdout may be no real file
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nobody reads further output
        return PIPE_CLOSED
    code, message = _classify(error)
    if debug or code == INTERNAL:
        traceback.print_exception(error)
    print(f"coview: {' '.join(message.split())}", file=sys.stderr)
    return code


def _classify(error: BaseException) -> tuple[int, str]:
    """Exit code and line of an error, by its type. Checks of input raise ValueError or OSError, and nothing else."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, "stopped, nothing is left half written; start the same command again"
    if isinstance(error, WorkLost):
        return LOST, str(error)
    if isinstance(error, ImportError) and (error.name or "").partition(".")[0] not in OURS:
        return MISSING, str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        remedy = "give another path, or make this one readable and writable"
        return BAD_INPUT, f"cannot use {error.filename}: {error.strerror}; {remedy}"  # without the error's number
    if isinstance(error, OSError | ValueError):
        return BAD_INPUT, str(error)
    return INTERNAL, REPORT
