"""The page: every experiment with its picture, and a table of our figures, the paper's and the differences, in one file
that opens from disk, asks for nothing else and prints."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape

from placement_env.report.paper.comparison import HEADS, LARGE, Compared, Experiment

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1a1a1a; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #999; }
table { border-collapse: collapse; font-size: 0.82rem; margin: 0.8rem 0; } caption { text-align: left; color: #444; }
th, td { padding: 0.15rem 0.55rem; border-bottom: 1px solid #ddd; text-align: left; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.large td.number:nth-last-child(2) { font-weight: bold; } tr.large { background: #fff4df; }
img { max-width: 100%; height: auto; } dt { font-weight: bold; float: left; clear: left; width: 1.5rem; }
dd { margin: 0 0 0.5rem 2rem; } .basis { color: #444; font-size: 0.88rem; } nav a { margin-right: 1rem; }
@media print { body { margin: 0; max-width: none; font-size: 10pt; } section { break-before: page; }
  nav { display: none; }
  tr { break-inside: avoid; } thead { display: table-header-group; } tr.large { background: none; } }
"""


def paper_page(
    title: str,
    experiments: Sequence[Experiment],
    pictures: Mapping[str, bytes],
    *,
    conditions: Mapping[str, str],
    causes: Mapping[str, str],
) -> str:
    """The page as HTML. pictures: SVG by the experiment's name; conditions: how it was computed; causes: by letter."""
    large = [(each, row) for each in experiments for row in each.rows if row.large]
    compared = sum(row.unit == "AP" and row.difference is not None for each in experiments for row in each.rows)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{len(large)} of {compared} AP differ from the paper's by more than {LARGE:g}; each says why in its row. "
        "Intervals hold 95 % of a bootstrap over blocks of four frames.</p>",
        "<nav>" + "".join(f'<a href="#{each.name}">{escape(each.title)}</a>' for each in experiments) + "</nav>",
        _conditions(conditions),
        *(_section(each, pictures[each.name]) for each in experiments),
        '<section id="causes"><h2>Causes of differences</h2><dl>',
        *(f"<dt>{escape(letter)}</dt><dd>{escape(text)}</dd>" for letter, text in causes.items()),
        "</dl></section>",
    ]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n' + "\n".join(parts) + "\n</body></html>\n"


def _conditions(conditions: Mapping[str, str]) -> str:
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in conditions.items())
    return f"<table><caption>How it was computed</caption><tbody>{rows}</tbody></table>"


def _section(experiment: Experiment, picture: bytes) -> str:
    image = f"data:image/svg+xml;base64,{b64encode(picture).decode()}"
    return "\n".join(
        [
            f'<section id="{experiment.name}"><h2>{escape(experiment.title)}</h2>',
            f'<p class="basis">Paper: {escape(experiment.source)}. Ours: {escape(experiment.basis)}.</p>',
            f"<p>{escape(experiment.conclusion)}</p>",
            f'<img alt="{escape(experiment.title)}" src="{image}">',
            _table(experiment),
            "</section>",
        ]
    )


def _table(experiment: Experiment) -> str:
    labels, figures = len(experiment.heads), ("unit", "ours", "interval", "paper", "difference", HEADS[-1])
    heads = [f"<th>{escape(head)}</th>" for head in experiment.heads]
    heads += [f"<th{_kind(place)}>{escape(head)}</th>" for place, head in enumerate(figures)]
    rows = [_row(row, labels) for row in experiment.rows]
    return f"<table><thead><tr>{''.join(heads)}</tr></thead><tbody>\n" + "\n".join(rows) + "\n</tbody></table>"


def _row(row: Compared, labels: int) -> str:
    cells = [f"<td{_kind(place - labels)}>{escape(cell)}</td>" for place, cell in enumerate(row.cells)]
    large = ' class="large"' if row.large else ""
    return f"<tr{large}>{''.join(cells)}</tr>"


def _kind(place: int) -> str:
    """Of a cell after the labels: unit and reason are words, the others numbers."""
    return ' class="number"' if 1 <= place <= 4 else ""
