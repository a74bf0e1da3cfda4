"""The report of a plan, as report.html and report.pdf.

Its sections come in the order in which a reader needs them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from placement_env.cases import iou_text
from placement_env.handover.ground import GroundGrid
from placement_env.report import content
from placement_env.report.pages.decision import decision_section
from placement_env.report.pages.detection_section import detection_section
from placement_env.report.pages.document import Document, Paragraph, Section, build_content
from placement_env.report.pages.ground_section import ground_section
from placement_env.report.pages.installation_sections import (
    links_section,
    materials_section,
    schedule_section,
    views_section,
)
from placement_env.report.pages.method_section import method_section
from placement_env.report.pages.motion_section import motion_section
from placement_env.report.pages.others_section import others_section
from placement_env.report.pages.printable_names import drop_unset, settle_names, use_pole_names
from placement_env.report.pages.scene import build_plan_scene
from placement_env.report.pages.schemes_section import schemes_section
from placement_env.report.pages.sensors_sections import (
    failures_section,
    order_section,
    worth_section,
)
from placement_env.report.pages.typesetting import to_html, to_pdf
from toolkit.runtime.writing import writing_together
from toolkit.sites.site import Site

REPORT_FILES = ("report.html", "report.pdf")
NOTHING_CHOSEN = "No set of sensors may be built, so there is nothing to show here."


def build_document(
    plan: content.Plan,
    site: Site,
    ground: GroundGrid | None,
    moments: Sequence[content.SceneMoment] = (),
) -> Document:
    """Build the report of a plan as one structure, for both HTML and PDF.

    Without a chosen set, most sections only state that nothing may be built.

    Args:
        plan: The plan, with or without a chosen set.
        site: Site with the chosen sensors mounted.
        ground: Ground that they see, None if unknown.
        moments: Frames with the clouds of the sensors."""
    contents = dict.fromkeys(content.TEXTS["titles"], build_content(NOTHING_CHOSEN))
    contents["decision"] = decision_section(plan, site, ground)
    contents["ground"] = ground_section(plan, site, ground)
    contents["method"] = method_section(plan)
    if plan.chosen is not None:
        contents |= {
            "schedule": schedule_section(plan, site),
            "views": views_section(plan, site, moments),
            "materials": materials_section(plan),
            "detection": detection_section(plan),
            "motion": motion_section(plan),
            "failures": failures_section(plan, plan.chosen),
            "links": links_section(plan),
            "order": order_section(plan),
            "others": others_section(plan, plan.chosen),
            "schemes": schemes_section(plan),
            "worth": worth_section(plan),
        }
    sections = tuple(
        Section(key, title, *contents[key]) for key, title in content.TEXTS["titles"].items()
    )
    judging_note = f"{plan.detector}; AP at IoU {iou_text(plan.iou)}; {plan.scheme} fusion"
    head = [plan.head[key] for key in ("client", "date", "author") if plan.head.get(key)]
    subtitle = "; ".join([*head, judging_note if plan.detector else "No set was judged"])
    title = plan.head.get("title") or f"Deployment plan for {plan.site}"
    return Document(title, subtitle, sections, logo=plan.head.get("logo", ""))


def add_note(document: Document, note: str) -> Document:
    """Return the document with a note at the end of its first section.

    note: a sentence, "" to change nothing."""
    if not note:
        return document
    first_section = document.sections[0]
    noted_section = replace(first_section, blocks=(*first_section.blocks, Paragraph(note)))
    return replace(document, sections=(noted_section, *document.sections[1:]))


def write_report(planned: content.Planned, out: Path) -> None:
    """Write `REPORT_FILES` into a folder, made if missing.

    Both are written or neither, with the same bytes each time. Raises ImportError without the
    packages of `coview[report]`, OSError if the folder cannot be written."""
    # all mounts that candidates had, so that maps show those without a sensor too
    mounts = planned.candidates.mounts if planned.candidates else planned.site.mounts
    # names with letters that no font can set become numbers; the note explains the numbers
    plan, site, note = settle_names(
        use_pole_names(planned.plan), replace(planned.site, mounts=mounts)
    )
    ground = planned.ground
    document = build_document(plan, site, ground, planned.moments)
    document = drop_unset(add_note(document, note))
    scene = None if plan.chosen is None else build_plan_scene(plan, site, ground, planned.moments)
    with writing_together(out) as folder:
        (folder / "report.html").write_text(to_html(document, scene), encoding="utf-8")
        (folder / "report.pdf").write_bytes(to_pdf(document))
