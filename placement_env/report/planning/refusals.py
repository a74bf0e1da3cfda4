"""Reasons why no set of sensors can be planned, and the plan that gives them."""

from collections.abc import Sequence
from dataclasses import replace

from placement_env.candidates.candidates import Candidates
from placement_env.report import content
from placement_env.report.planning.question import Question
from toolkit.display import describe_count


class Refusal(Exception):
    """Raised by a stage of planning if no set can be planned.

    Attributes:
        reasons: Sentences for the verdict.
        candidates: Candidates of the question, None if there are none."""

    def __init__(self, reasons: tuple[str, ...], candidates: Candidates | None = None) -> None:
        super().__init__(*reasons)
        self.reasons = reasons
        self.candidates = candidates


def refuse_question(question: Question) -> tuple[str, ...]:
    """List in sentences the reasons against any plan that are known without simulation.

    Empty if a plan may be made."""
    if question.sensors == 0:
        return ("The budget is 0 sensors, so there is nothing to build: allow 1 or more.",)
    if question.site.network:
        return ()
    return (
        f"Site {question.site.name!r} has no road network, so there is no traffic to plan for: "
        "import one from a map, or build one with toolkit.sites.network.",
    )


def refuse_traffic(
    question: Question, missing: Sequence[str], frames: int, part_name: str
) -> tuple[str, ...]:
    """Explain in one sentence that one part of the traffic lacks counted classes.

    Args:
        question: The question.
        missing: Names of the classes without an object.
        frames: Number of frames of this part.
        part_name: Adjective for the part in the sentence, such as "simulated"."""
    return (
        f"No {' and no '.join(missing)} enters the detection area of site {question.site.name!r} "
        f"in {describe_count(frames, 'frame')} of {part_name} traffic: increase --frames, change "
        "--seed, or enlarge the area.",
    )


def refuse(question: Question, refusal: Refusal) -> content.Planned:
    """Return a plan without sensors, whose verdict gives the reasons of a refusal."""
    verdict = content.Verdict(
        met=False, sentence="No set of sensors can be planned.", reasons=refusal.reasons
    )
    plan = content.Plan(
        question=question.as_dict(),
        site=question.site.name,
        detector="",
        iou=question.cases.threshold,
        scheme=question.setting.fusion.name,
        currency=question.currency,
        verdict=verdict,
        chosen=None,
        head=question.stock.head,
    )
    site = replace(question.site, sensors=())
    return content.Planned(plan, site, candidates=refusal.candidates)
