"""Command line: find a command, call it, return its code."""

import os
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

_TABLE = tomllib.loads((Path(__file__).parent / "commands.toml").read_text(encoding="utf-8"))
GROUPS: dict[str, dict[str, tuple[str, str]]] = _TABLE["groups"]
COMMANDS: dict[str, str] = {}  # modules of commands by name
for _group in GROUPS.values():
    COMMANDS.update((_name, _row[0]) for _name, _row in _group.items())
STUDIES = frozenset(GROUPS["Studies"])
PACKAGES = ("toolkit", "models", "placement_env")
USAGE: str = _TABLE["usage"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command line, by default that with which the process was started, and exit."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code.

    arguments: words of the command line, without the name of the program."""
    _replace_closed_streams()
    debug = "--debug" in arguments
    options = [argument for argument in arguments if argument != "--debug"]
    # no other module of coview is imported before packages that would hide it are refused
    try:
        if options[:1] in ([], ["-h"], ["--help"], ["--version"]):
            return _print_overview(options[:1])
        refuse_hidden_packages()
    except ValueError as error:
        print(f"coview: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        from coview.outputs import report

        return report(error)
    from coview.outputs import report
    from toolkit.runtime.allocation import keep_freed_memory

    keep_freed_memory()
    try:
        code = _run_command(options)
        sys.stdout.flush()  # a closed pipe shows here, not when Python ends
    except (Exception, KeyboardInterrupt) as error:
        code = report(error, debug=debug)
    return code


def _replace_closed_streams() -> None:
    """Open the null device for closed standard streams, so that no file takes their numbers."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def _print_overview(options: Sequence[str]) -> int:
    """Print the overview, on stderr without any option, or the version; return the exit code.

    options: nothing, or one of -h, --help and --version."""
    if options == ["--version"]:
        from coview import __version__

        print(f"coview {__version__}")
    else:
        print(format_overview(), end="", file=sys.stdout if options else sys.stderr)
    sys.stdout.flush()
    return 0 if options else 2


def format_overview() -> str:
    """Return the usage, and every command in a line, by group."""
    lines = []
    for title, group in GROUPS.items():
        lines += ["", f"{title}:"]
        lines += [f"  {name:10} {row[1]}" for name, row in group.items()]
    return USAGE.format("\n".join([*lines, ""]))


def _run_command(arguments: Sequence[str]) -> int:
    """Parse a command line, run its command, and return the exit code.

    Raises ValueError, in one line, for what the parser refuses."""
    import io
    import warnings
    from contextlib import redirect_stderr
    from functools import partial, wraps

    import tyro

    from coview.outputs import say
    from coview.refusals import describe_near, describe_refusal, record_refusals

    if arguments[0] not in COMMANDS and not arguments[0].startswith("-"):
        remedy = describe_near(arguments[0], list(COMMANDS))
        if not remedy:
            remedy = f": choose among {', '.join(COMMANDS)}"
        raise ValueError(f"unknown command {arguments[0]!r}{remedy}")
    warnings.showwarning = lambda message, *_, **__: say(f"coview: note: {message}", error=True)

    def delay(run_one: Callable[..., int]) -> Callable[..., Callable[[], int]]:
        """Return a command's function that only keeps its arguments, with the same help."""
        return wraps(run_one)(lambda *args, **options: partial(run_one, *args, **options))

    tyro_output = io.StringIO()
    names = [name for name in arguments[:1] if name in COMMANDS]
    if not names:
        names = [name for name in COMMANDS if name not in STUDIES]  # a wheel has no studies
    try:
        with redirect_stderr(tyro_output), record_refusals() as events:
            run_parsed = tyro.extras.subcommand_cli_from_dict(
                {name: delay(command(name)) for name in names},
                prog="coview",
                args=arguments,
                config=(
                    tyro.conf.OmitSubcommandPrefixes,
                    tyro.conf.OmitArgPrefixes,
                    tyro.conf.SuppressFixed,
                ),
            )
    except SystemExit as stopped:
        refusal = _find_refusal(stopped)
        if refusal is not None:
            raise refusal from None
        if events and (line := describe_refusal(events[-1], tyro_output.getvalue(), arguments)):
            raise ValueError(line) from None
        if tyro_output.getvalue():
            say(tyro_output.getvalue().rstrip("\n"), error=True)
        return stopped.code if isinstance(stopped.code, int) else 0
    return run_parsed()


def _find_refusal(stopped: SystemExit) -> ValueError | None:
    """ValueError of coview's code that made the parser exit, None for a refusal of the parser.

    The parser turns errors of our option classes into its exit, whose `__context__` keeps them."""
    from traceback import walk_tb

    from coview.outputs import OURS

    error: BaseException | None = stopped
    while error is not None:
        if isinstance(error, ValueError):
            for frame, _ in walk_tb(error.__traceback__):
                package = frame.f_globals["__name__"].partition(".")[0]
                if package in OURS:
                    return error
        error = error.__context__
    return None


def command(name: str) -> Callable[..., int]:
    """Load the function of a command. Raises ImportError for a study that is not here."""
    from importlib import import_module

    if name in STUDIES:
        from coview.studies import import_study

        module = import_study(COMMANDS[name])
    else:
        module = import_module(f"coview.commands.{COMMANDS[name]}")
    return getattr(module, f"{name.replace('-', '_')}_command")


def refuse_hidden_packages() -> None:
    """Raise ValueError if a file or folder of the user is imported in place of our packages."""
    from importlib.util import find_spec

    home = Path(__file__).resolve().parents[1]
    for name in PACKAGES:
        spec = find_spec(name)
        # file of the package, else its folders, as a folder without __init__.py has no file
        locations = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
        package_path = next((Path(location).resolve() for location in locations if location), None)
        if package_path is None:
            raise ValueError(f"{name}, a part of coview, is not installed: install coview again")
        if not package_path.is_relative_to(home / name):
            raise ValueError(
                f"{package_path} hides {name}, a part of coview: rename it, or start Python from "
                "another folder and without it in PYTHONPATH"
            )
