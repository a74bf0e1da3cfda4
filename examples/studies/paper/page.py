"""Page of a reproduction: one file that opens from disk, requests nothing and prints."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from examples.studies.paper.comparison import HEADS, LARGE_AP_DIFFERENCE, Experiment


def paper_page(
    title: str,
    experiments: Sequence[Experiment],
    pictures: Mapping[str, bytes],
    *,
    conditions: Mapping[str, str],
    causes: Mapping[str, str],
) -> str:
    """Build the page as HTML.

    pictures: SVG by name of the experiment; conditions: how the figures were computed, by name;
    causes: causes of differences, by the letter that reasons use."""
    rows = [row for experiment in experiments for row in experiment.rows]
    compared_count = sum(row.unit == "AP" and row.difference is not None for row in rows)
    condition_rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
        for name, value in conditions.items()
    )
    large_count = sum(row.large for row in rows)
    links = "".join(
        f'<a href="#{experiment.name}">{escape(experiment.title)}</a>' for experiment in experiments
    )
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{large_count} of {compared_count} AP values differ from the paper's by more than "
        f"{LARGE_AP_DIFFERENCE:g}; the reason stands in the row. Intervals are 95 % intervals of a "
        "bootstrap over blocks of eight frames.</p>",
        f"<nav>{links}</nav>",
        "<table><caption>How the figures were computed</caption>"
        f"<tbody>{condition_rows}</tbody></table>",
    ]
    parts += [_section(experiment, pictures[experiment.name]) for experiment in experiments]
    parts.append('<section id="causes"><h2>Causes of differences</h2><dl>')
    parts += [
        f"<dt>{escape(letter)}</dt><dd>{escape(text)}</dd>" for letter, text in causes.items()
    ]
    parts.append("</dl></section>")
    body = "\n".join(parts)
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>\n{style}</style>'
    return f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n{body}\n</body></html>\n'


def _section(experiment: Experiment, picture: bytes) -> str:
    # HTML of one experiment: its conclusion, picture (SVG) and table
    def cells(tag: str, texts: Sequence[str]) -> str:
        # labels, unit and reason are words; the columns between unit and reason are numbers
        first_number = len(experiment.heads) + 1
        parts = []
        for column, text in enumerate(texts):
            is_number = first_number <= column < first_number + 4
            kind = ' class="number"' if is_number else ""
            parts.append(f"<{tag}{kind}>{escape(text)}</{tag}>")
        return "".join(parts)

    heads = cells(
        "th", (*experiment.heads, "unit", "ours", "interval", "paper", "difference", HEADS[-1])
    )
    rows = []
    for row in experiment.rows:
        kind = ' class="large"' if row.large else ""
        rows.append(f"<tr{kind}>{cells('td', row.cells)}</tr>")
    title = escape(experiment.title)
    table_rows = "\n".join(rows)
    image = b64encode(picture).decode()
    lines = [
        f'<section id="{experiment.name}"><h2>{title}</h2>',
        (
            f'<p class="basis">Paper: {escape(experiment.source)}. Ours: '
            f"{escape(experiment.basis)}.</p>"
        ),
        f"<p>{escape(experiment.conclusion)}</p>",
        f'<img alt="{title}" src="data:image/svg+xml;base64,{image}">',
        f"<table><thead><tr>{heads}</tr></thead><tbody>\n{table_rows}\n</tbody></table>",
        "</section>",
    ]
    return "\n".join(lines)
