"""Section on the method: how the plan was worked out, what it assumes, what it does not know."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from placement_env.report.content import Plan
from placement_env.report.pages.document import Bullets, Column, Paragraph, ReportBlock, Section, table
from placement_env.report.pages.sections_answer import in_words
from placement_env.report.pages.wording import counted, listed, text_cell


def method_section(plan: Plan) -> Section:
    """How it was computed, assumptions, unknowns, provenance."""
    judged = plan.chosen.judged if plan.chosen else None
    conclusion = (
        f"Every AP here is that of {plan.detector} in simulated traffic"
        + (f", {counted(judged.vehicles, judged.kind)} in {counted(judged.frames, 'frame')}" if judged else "")
        + ": it ranks places for sensors, and does not replace a trial on the street."
        if plan.detector
        else "Nothing was judged by a detector, because no set of sensors may be built."
    )
    blocks: list[ReportBlock] = []
    if plan.considered:
        judged_sets = sum(each.judged is not None for each in plan.considered)
        found = {name for option in plan.considered for name in option.searches}
        by = f", found by the searches {listed(sorted(found))}" if found else ""
        sets = f"{counted(len(plan.considered), 'set')} of sensors came to the final comparison{by}; "
        blocks.append(Paragraph(f"{sets}the detector judged {judged_sets} of them on all of its traffic."))
    for heading, sentences in (("What it assumes:", plan.assumptions), ("What it does not know:", plan.unknown)):
        if sentences:
            blocks += [Paragraph(heading), Bullets(sentences)]
    rows = [(text_cell(name), text_cell(value)) for name, value in _flat(plan.provenance)]
    columns = (Column("Input, seed or version", number=False), Column("Value", number=False))
    caption = "Where the figures come from: the same inputs, seeds and versions give the same plan"
    return Section("method", "How this was worked out", conclusion, (*blocks, *table(caption, columns, rows)))


def _flat(provenance: dict[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    for name, value in provenance.items():
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{before}{name}: ")
        else:
            yield f"{before}{name}".replace("_", " "), in_words(value)
