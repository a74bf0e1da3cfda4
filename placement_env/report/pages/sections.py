"""The report of a plan as a document: its sections in the order in which a reader needs them."""

from __future__ import annotations

from placement_env.report.content import Ground, Plan
from placement_env.report.pages.document import Document
from placement_env.report.pages.sections_answer import alternatives, chosen_set, front, requirement
from placement_env.report.pages.sections_building import links, materials, schedule
from placement_env.report.pages.sections_detection import detection, schemes
from placement_env.report.pages.sections_ground import ground_seen
from placement_env.report.pages.sections_method import method
from placement_env.report.pages.sections_resilience import build_order, failures, worth
from toolkit.sites.site import Site


def report_of(plan: Plan, site: Site, ground: Ground | None) -> Document:
    """The document. site: with the chosen sensors mounted; ground: what they see of it, None without any."""
    sections = (
        requirement(plan),
        chosen_set(plan, site, ground),
        ground_seen(plan, site, ground),
        detection(plan),
        schemes(plan),
        front(plan),
        worth(plan),
        failures(plan),
        links(plan),
        materials(plan),
        schedule(plan),
        build_order(plan),
        alternatives(plan),
        method(plan),
    )
    subtitle = (
        f"{plan.detector}; AP at IoU {plan.iou:g}; {plan.scheme} fusion" if plan.detector else "No set was judged"
    )
    return Document(f"Deployment plan for {plan.site}", subtitle, sections)
