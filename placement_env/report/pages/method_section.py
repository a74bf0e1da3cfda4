"""Section of the report on the computation, its assumptions and its provenance."""

from collections.abc import Iterator, Mapping

from placement_env.classes import join_names
from placement_env.report import content
from placement_env.report.pages.columns import text_columns
from placement_env.report.pages.document import (
    Bullets,
    Content,
    Paragraph,
    ReportBlock,
    build_content,
    build_table,
)
from toolkit.display import describe_count


def value_text(value: object) -> str:
    """Write a value of the question or provenance for readers.

    Lists and mappings become one line; empty values and None read "not given"."""
    if value is None or value == "" or value == [] or value == () or value == {}:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {value_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(value_text, value))
    return str(value)


def method_section(plan: content.Plan) -> Content:
    """Describe the computation, assumptions, unknowns and provenance of a plan.

    The question and the provenance are tables with a row for each value."""
    judgement = plan.chosen.judged if plan.chosen else None
    sample = ""
    if judgement:
        sample = (
            f", {describe_count(judgement.vehicles, judgement.kind)} in "
            f"{describe_count(judgement.frames, 'frame')}"
        )
    conclusion = "No detector judged anything, because no set of sensors may be built."
    if plan.detector:
        conclusion = (
            f"Every AP here is that of {plan.detector} in simulated traffic{sample}: it ranks "
            "places for sensors, and does not replace a trial on the street."
        )
    blocks: list[ReportBlock] = []
    if plan.why:
        blocks += [Paragraph(plan.verdict.sentence), Bullets(plan.why)]
    if plan.considered:
        judged_text = plan.describe_judged("of them on all of its traffic")
        searches = {name for option in plan.considered for name in option.searches}
        searches_text = (
            f", found by the searches {join_names(sorted(searches))}" if searches else ""
        )
        sets_text = (
            f"{describe_count(len(plan.considered), 'set')} of sensors reached the final "
            f"comparison{searches_text}; "
        )
        blocks.append(Paragraph(f"{sets_text}the detector judged {judged_text}."))
    if plan.assumptions:
        blocks += [Paragraph("What it assumes:"), Bullets(plan.assumptions)]
    if plan.unknown:
        blocks += [Paragraph("What it does not know:"), Bullets(plan.unknown)]
    question_rows = [
        (str(key).replace("_", " "), value_text(value)) for key, value in plan.question.items()
    ]
    settings = build_table(
        "The question that this plan answers", text_columns("Asked", "Value"), question_rows
    )
    caption = "Origin of the figures: the same inputs, seeds and versions give the same plan"
    origin = build_table(
        caption, text_columns("Input, seed or version", "Value"), [*_flatten(plan.provenance)]
    )
    return build_content(conclusion, *blocks, *settings, *origin)


def _flatten(provenance: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each value, also of values in mappings inside.

    prefix: names of the mappings that hold this one, which names of values begin with."""
    for name, value in provenance.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{prefix}{name}: ")
        else:
            yield f"{prefix}{name}".replace("_", " "), value_text(value)
