"""Sphinx directive `commands`: the command line, from the parsers that `coview --help` shows."""

import warnings
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Iterator
from typing import Any

import tyro
from docutils import nodes
from faces import as_rst
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from coview.main import COMMANDS, command

CONFIG = (tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)


class Commands(SphinxDirective):
    """`.. commands::` documents every command of coview."""

    def run(self) -> list[nodes.Node]:
        """Write a section for each command."""
        lines = [line for name in COMMANDS for line in section(name)]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def parser(name: str) -> ArgumentParser:
    """Return the parser of a command."""
    function = command(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # tyro has no other way to its parsers
        return tyro.extras.get_parser(function, prog=f"coview {name}", config=CONFIG)


def section(name: str) -> Iterator[str]:
    """Return the lines of a command: purpose, arguments, subcommands."""
    main = parser(name)
    yield from (
        f"coview {name}",
        "-" * len(f"coview {name}"),
        "",
        *described(main.description),
        *options(main),
    )
    for word, below in subcommands(main).items():
        title = f"coview {name} {word}"
        yield from (title, "^" * len(title), "", *described(below.description), *options(below))


def described(text: str | None) -> Iterator[str]:
    """Return the text of a command, with its examples as code.

    >>> list(described("Count.\\n\\nExample: coview survey a.hdf5"))
    ['Count.', '', '.. code-block:: console', '', '   $ coview survey a.hdf5', '']
    """
    for paragraph in (text or "").split("\n\n"):
        example = paragraph.removeprefix("Example: ")
        if example != paragraph:
            yield from (".. code-block:: console", "", f"   $ {' '.join(example.split())}", "")
        else:
            yield from as_rst(paragraph)


def subcommands(main: ArgumentParser) -> dict[str, ArgumentParser]:
    """Return the parsers of the subcommands, by name."""
    below = [action.choices for action in main._actions if isinstance(action.choices, dict)]
    return dict(below[0]) if below else {}


def options(main: ArgumentParser) -> Iterator[str]:
    """Return a definition of every argument."""
    for action in main._actions:
        if isinstance(action.choices, dict) or action.dest == "help" or action.help == SUPPRESS:
            continue
        yield from (
            f"``{heading(action)}``",
            *(f"   {line}" for line in as_rst(action.help or "") if line),
            "",
        )


def heading(action: Any) -> str:
    """Return an argument as it is typed."""
    if not action.option_strings:
        return str(action.dest).rpartition(".")[2].upper()
    names = [name for name in action.option_strings if not name.startswith("--no-")]
    value = "" if action.nargs == 0 else str(action.metavar or "").removeprefix("{None}|")
    return " ".join([*names, value]).strip()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
