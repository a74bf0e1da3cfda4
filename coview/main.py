"""The command line: finds the command, calls it, and turns what it returns or raises into an exit code."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from functools import partial, wraps
from importlib import import_module
from traceback import walk_tb
from typing import Any

from coview import __version__
from coview.hidden_packages import refuse_hidden_packages

COMMANDS = {  # each with its room of `coview.commands`, in the order of --help
    "demo": "placement",
    "simulate": "recordings",
    "detect": "detection",
    "evaluate": "detection",
    "survey": "recordings",
    "view": "recordings",
    "convert": "recordings",
    "fuse": "recordings",
    "doctor": "recordings",
    "calibrate": "recordings",
    "site": "recordings",
    "pack": "recordings",
    "stress": "detection",
    "train": "detection",
    "search": "placement",
    "plan": "placement",
    "table": "placement",
    "surrogate": "placement",
    "reproduce": "placement",
}
DESCRIPTION = """Fuse, detect and measure what several sensors see of a junction, and search which to build.

--version prints the version; --debug, with any command, shows the traceback of every error.

Exit codes: 0 done, 1 the answer is no: the doctor suspects something, a plan's requirement cannot be met; 2 bad input,
3 a package is missing, 4 a worker died, 70 a fault of coview itself, 130 stopped, 141 nobody reads the output any more.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command line, that of the process if none is given, and exit."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run a command line; its exit code."""
    debug, rest = "--debug" in arguments, [each for each in arguments if each != "--debug"]
    warnings.showwarning = lambda message, *_, **__: print(f"coview: note: {message}", file=sys.stderr)
    try:
        refuse_hidden_packages()
    except ValueError as error:  # before anything of ours is imported
        print(f"coview: {error}", file=sys.stderr)
        return 2
    from coview.exits import report
    from toolkit.runtime.parallel import keep_freed_memory

    keep_freed_memory()
    try:
        code = _called(rest)
        sys.stdout.flush()  # here, where a closed pipe is met, not when Python ends
    except (Exception, KeyboardInterrupt) as error:
        code = report(error, debug=debug)
    return code


def _called(arguments: Sequence[str]) -> int:
    """Return the exit code of the command, or of the parser, which exits after --help and for unknown arguments."""
    import tyro

    if arguments[:1] == ["--version"]:
        print(f"coview {__version__}")
        return 0
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            call = tyro.extras.subcommand_cli_from_dict(
                {name: _delayed(each) for name, each in _commands(arguments).items()},
                prog="coview",
                description=DESCRIPTION,
                args=arguments,
                config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes, tyro.conf.SuppressFixed),
            )
    except SystemExit as stopped:
        refusal = _own_refusal(stopped)
        if refusal is not None:
            raise refusal from None
        print(said.getvalue(), end="", file=sys.stderr)
        return stopped.code if isinstance(stopped.code, int) else 0
    return call()


def _delayed(command: Callable[..., int]) -> Callable[..., Callable[[], int]]:
    """Wrap a command so that parsing its arguments does not yet run it."""

    @wraps(command)
    def delayed(*args: Any, **options: Any) -> Callable[[], int]:
        return partial(command, *args, **options)

    return delayed


def _own_refusal(stopped: SystemExit) -> ValueError | None:
    """Error that one of our dataclasses raised while the parser built it, which the parser turned into an exit."""
    from coview.exits import OURS

    error: BaseException | None = stopped
    while error is not None:
        frames = walk_tb(error.__traceback__) if isinstance(error, ValueError) else ()
        if any(frame.f_globals["__name__"].partition(".")[0] in OURS for frame, _ in frames):
            assert isinstance(error, ValueError)
            return error
        error = error.__context__
    return None


def _commands(arguments: Sequence[str]) -> dict[str, Callable[..., int]]:
    """All commands by name, or the one that is asked for, so that the others need not be imported."""
    wanted = [name for name in arguments[:1] if name in COMMANDS] or COMMANDS
    return {name: command(name) for name in wanted}


def command(name: str) -> Callable[..., int]:
    """The function behind a name of `COMMANDS`."""
    return getattr(import_module(f"coview.commands.{COMMANDS[name]}.{name}"), name)
