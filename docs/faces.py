"""Sphinx directive `face`: everything that a package offers, room by room, from the docstrings.

Docstrings here are plain text. `as_rst` hands them to Sphinx as what they mean: paragraphs, lists,
indented blocks as they are, and words in backticks as code, which links to the entry of what it
names where there is one.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from itertools import groupby
from types import ModuleType
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

# whose names have entries; other faces offer some of these again
FACES = ("toolkit", "models", "placement_env")
LIST_ITEM = re.compile(r"(?:[-*]|\d+\.) ")
CODE = re.compile(r"`([^`]+)`")
SPECIAL = re.compile(r"([\\*|`]|_(?=\W|$)|(?<=\W):(?=\w))")


class Face(SphinxDirective):
    """`.. face:: toolkit` documents every name of its `__all__`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Write a section for each room and an entry for each name."""
        return self.parse_text_to_nodes(
            "\n".join(page(self.arguments[0])), allow_section_headings=True
        )


class Offered(SphinxDirective):
    """`.. offered:: coview` lists the names of a face whose entries are on the pages of other
    faces."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Write one list of links."""
        package = self.arguments[0]
        entries = entry_names()
        items = [f"* {linked(name, entries[f'{package}.{name}'])}" for name in offers(package)]
        return self.parse_text_to_nodes("\n".join(items))


def offers(face: str) -> list[str]:
    """Return the names that a face offers."""
    return [name for name in dir(import_module(face)) if not name.startswith("_")]


def page(face: str) -> Iterator[str]:
    """Return the lines of a face's reference."""
    package = import_module(face)
    offered = sorted((room(face, getattr(package, name)), name) for name in offers(face))
    for title, members in groupby(offered, key=lambda pair: pair[0]):
        yield from (title, "-" * len(title), "")
        for _, name in members:
            yield from entry(face, name, getattr(package, name))


def room(face: str, member: Any) -> str:
    """Return the room of a face in which a member is defined.

    >>> room("toolkit", room)
    'faces'
    """
    parts = origin(member).removeprefix(f"{face}.").split(".")
    return parts[0]


def origin(member: Any) -> str:
    """Return the name of the module in which a member is defined, or of the module itself."""
    return (
        member.__name__
        if isinstance(member, ModuleType)
        else str(getattr(member, "__module__", ""))
    )


def entry(face: str, name: str, member: Any) -> Iterator[str]:
    """Return the directive that documents one name."""
    if isinstance(member, ModuleType):
        yield from (f".. py:module:: {face}.{name}", "", *as_rst(inspect.getdoc(member) or ""), "")
        yield from (f".. autofunction:: {face}.{name}.search", "")
    elif inspect.isclass(member):
        yield from (f".. autoclass:: {face}.{name}", "   :members:", "")
    else:
        yield from (f".. autofunction:: {face}.{name}", "")


def entry_names() -> dict[str, str]:
    """Return the entry of every name, by each full name it goes by."""
    entries: dict[str, str] = {}
    for face in (*FACES, "placement_env.search", "coview"):
        package = import_module(face)
        for name in offers(face):
            member = getattr(package, name)
            home = (
                f"{origin(member)}.{name}" if not isinstance(member, ModuleType) else origin(member)
            )
            entries.setdefault(home, f"{face}.{name}")
            entries[f"{face}.{name}"] = entries[home]
    return entries


def linked(text: str, target: str) -> str:
    """Return a link to an entry."""
    return f":py:obj:`{text} <{target}>`"


def as_rst(docstring: str) -> list[str]:
    """Return a plain-text docstring as lines of reStructuredText.

    >>> as_rst("Boxes of `n` * 7.\\n\\n    a | b\\n\\nEnd.")
    ['Boxes of ``n`` \\\\* 7.', '', '::', '', '    a | b', '', 'End.', '']
    """
    lines: list[str] = []
    blocks = re.split(r"\n\s*\n", docstring.strip("\n"))
    for indented, group in groupby(blocks, key=lambda block: block.startswith("    ")):
        if indented:
            lines += ["::", "", *"\n\n".join(group).split("\n"), ""]
        else:
            for block in group:
                lines += [*_block(block.split("\n")), ""]
    return lines


def _block(lines: list[str]) -> list[str]:
    """Convert one unindented block: a doctest, a heading, a list or a paragraph."""
    if lines[0].startswith(">>>"):
        return lines
    if len(lines) > 1 and re.fullmatch("[-=]{3,}", lines[1]):
        return [f"**{lines[0]}**", "", *_block(lines[2:])] if lines[2:] else [f"**{lines[0]}**"]
    doctest = next(
        (number for number, line in enumerate(lines) if line.startswith(">>>")), len(lines)
    )
    indented = next(
        (number for number, line in enumerate(lines) if line.startswith("    ")), len(lines)
    )
    if doctest < len(lines):
        return [*_block(lines[:doctest]), "", *lines[doctest:]]
    if indented < len(lines) and not LIST_ITEM.match(lines[0]):
        return [*_block(lines[:indented]), "", "::", "", *lines[indented:]]
    items: list[str] = []
    for line in lines:
        if LIST_ITEM.match(line) or not items:
            items.append(line.strip())
        else:
            items[-1] += " " + line.strip()
    return [_inline(item) for item in items]


def _inline(text: str) -> str:
    """Convert text in backticks to code and escape the rest."""
    bullet = LIST_ITEM.match(text)
    start = bullet.group() if bullet else ""
    pieces = CODE.split(text.removeprefix(start))
    return start + "".join(
        _code(piece) if odd % 2 else SPECIAL.sub(r"\\\1", piece) for odd, piece in enumerate(pieces)
    )


def _code(text: str) -> str:
    target = _known().get(text)
    return linked(text, target) if target else f"``{text}``"


_entries: dict[str, str] = {}


def _known() -> dict[str, str]:
    """Return the names that link: full ones, and short ones that are unique."""
    if not _entries:
        _entries.update(entry_names())
        for target in sorted(set(_entries.values())):
            _entries.setdefault(target.rpartition(".")[2], target)
    return _entries


class _AsWritten:
    """An annotation that prints as it stands in the source."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def signature(member: Any) -> str | None:
    """Return the signature with annotations as written, None if there is none.

    >>> signature(linked)
    '(text: str, target: str) -> str'
    """
    if inspect.isclass(member) and getattr(member, "_is_protocol", False):
        return ""
    try:
        found = inspect.signature(member)
    except (TypeError, ValueError):
        return None
    written = {name: _AsWritten(text) for name, text in _annotations(member).items()}
    parameters = [
        p.replace(annotation=written.get(p.name, p.annotation)) for p in found.parameters.values()
    ]
    returned = (
        inspect.Signature.empty
        if inspect.isclass(member)
        else written.get("return", found.return_annotation)
    )
    return str(found.replace(parameters=parameters, return_annotation=returned))


def _annotations(member: Any) -> dict[str, str]:
    """Annotations of a function, or of a class's fields and constructor, as they stand in the
    source."""
    parts: list[Any] = []
    for part in reversed(member.__mro__) if inspect.isclass(member) else [member]:
        with suppress(TypeError, OSError):  # built in, or made without source
            parts += ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(part)))).body
    written: dict[str, ast.expr | None] = {}
    for part in parts:
        for node in part.body if isinstance(part, ast.ClassDef) else [part]:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                written[node.target.id] = node.annotation
            elif isinstance(node, ast.FunctionDef) and (
                node is part or node.name in ("__init__", "__new__")
            ):
                a = node.args
                all_of = (
                    *a.posonlyargs,
                    *a.args,
                    *a.kwonlyargs,
                    *filter(None, (a.vararg, a.kwarg)),
                )
                written |= {
                    "return": node.returns,
                    **{each.arg: each.annotation for each in all_of},
                }
    return {
        name: node.value
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        else ast.unparse(node)
        for name, node in written.items()
        if node is not None
    }


def _signature(
    _app: Sphinx, what: str, _name: str, member: Any, _options: Any, *_: Any
) -> tuple[str, str | None] | None:
    """Show annotations as in the source, with shapes."""
    text = signature(member) if what in ("function", "method", "class") else None
    if text is None:
        return None
    if what == "method":
        text = re.sub(r"^\((self|cls)(, /)?(, )?", "(", text)
    arguments, arrow, returned = text.rpartition(" -> ")
    return (arguments, returned) if arrow else (text, None)


def _docstring(
    _app: Sphinx, _what: str, _name: str, _member: Any, _options: Any, lines: list[str]
) -> None:
    lines[:] = as_rst("\n".join(lines))


def _skip(
    _app: Sphinx, _what: str, _name: str, member: Any, skip: bool, _options: Any
) -> bool | None:
    """Drop the fields of named tuples, which the signature shows."""
    return (
        True
        if (inspect.getdoc(member) or "").startswith("Alias for field number")
        else skip or None
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.add_directive("face", Face)
    app.add_directive("offered", Offered)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _docstring)
    app.connect("autodoc-skip-member", _skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
