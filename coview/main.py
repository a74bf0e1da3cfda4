"""The command line: finds the command, calls it, and turns what it returns or raises into an exit code."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module

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
    from toolkit.runtime.memory import keep_freed_memory

    keep_freed_memory()
    try:
        code = _called(rest)
        sys.stdout.flush()  # here, where a closed pipe is met, not when Python ends
    except (Exception, KeyboardInterrupt) as error:
        code = report(error, debug=debug)
    return code


def _called(arguments: Sequence[str]) -> int:
    """What the command returns, or the parser, which exits after --help and for arguments it does not know."""
    import tyro

    if arguments[:1] == ["--version"]:
        print(f"coview {__version__}")
        return 0
    try:
        return tyro.extras.subcommand_cli_from_dict(
            _commands(arguments),
            prog="coview",
            description=DESCRIPTION,
            args=arguments,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        )
    except SystemExit as stopped:
        return stopped.code if isinstance(stopped.code, int) else 0


def _commands(arguments: Sequence[str]) -> dict[str, Callable[..., int]]:
    """All commands by name, or the one that is asked for, so that the others need not be imported."""
    wanted = [name for name in arguments[:1] if name in COMMANDS] or COMMANDS
    return {name: command(name) for name in wanted}


def command(name: str) -> Callable[..., int]:
    """The function behind a name of `COMMANDS`."""
    return getattr(import_module(f"coview.commands.{COMMANDS[name]}.{name}"), name)
