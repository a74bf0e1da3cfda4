"""`Findings`: what led to the chosen set, its checks and its provenance."""

import math
import platform
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version

from placement_env.analysis.agreement import StageFigure, check_agreement
from placement_env.analysis.intervals import BLOCK_FRAMES, RESAMPLES
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.traffic import Traffic
from placement_env.objective import Objective
from placement_env.protocol import Doubting
from placement_env.report import content
from placement_env.report.planning import choice, judging
from placement_env.report.planning.question import PART_FRAMES, Question
from placement_env.search.portfolio.entrants import Entrants
from toolkit.detection.provenance import coview_version, detector_origin
from toolkit.objects import Detector
from toolkit.sites.files import format_site

TRACED_PACKAGES = (
    "numpy",
    "torch",
    "open3d-cpu",
    "open3d",
    "eclipse-sumo",
    "libsumo",
    "ortools",
    "shapely",
)


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that led to the chosen set.

    Attributes:
        question: The question, narrowed to the poses that were searched.
        entrants: Sensor sets that the searches found.
        choice: The answer among the entrants.
        objective: Objective of the searches, at the first drawing of the site.
        network: Name of the shipped network that detects if the question has no detector.
        excluded: Sentences on what excludes candidates.
        traffic: Traffic of search, comparison and judgement, in the order of `PART_FRAMES`.
        drawings: Results at each drawing of what no map knows, empty for one drawing."""

    question: Question
    entrants: Entrants
    choice: choice.Choice
    objective: Objective
    network: str
    excluded: tuple[str, ...]
    traffic: Sequence[Traffic]
    drawings: tuple[content.DrawingResult, ...] = ()


def check_stages(findings: Findings, judged: content.Judgement) -> None:
    """Raise ValueError if prediction, comparison and judgement of the answer exclude each other.

    They exclude each other if their intervals have no AP in common (`check_agreement`).
    The prediction is for the shipped network without sensor errors and for plain cases, so it is
    compared only if the question is the same. A set that was not judged in the comparison has no
    figure there.

    judged: result of the intact answer in the judgement."""
    choice = findings.choice
    question = findings.question
    objective = findings.objective
    final_figure = judging.state_figure("in the judgement", judged)
    compared_judgement = choice.option.judged
    if compared_judgement is not None:
        compared_figure = judging.state_figure("in the comparison", compared_judgement)
        check_agreement(choice.option.sensors, compared_figure, final_figure)
    is_predicted = (
        question.setting.detector is None
        and question.cases.noise_only
        and question.cases.is_one_case
    )
    # a `Doubting` estimate states its typical error
    if is_predicted and isinstance(objective.scored_by, Doubting):
        is_member = choice.sets[choice.chosen]
        # the estimate takes many sets at a time; the error is not finite if it is unknown
        spread = float(objective.scored_by.spread(is_member[None])[0])
        if math.isfinite(spread):
            predicted_figure = StageFigure(
                "by the prediction",
                ap=choice.option.predicted,
                objects=judged.vehicles,
                frames=judged.frames,
                spread=spread,
            )
            check_agreement(choice.option.sensors, predicted_figure, final_figure)


def trace_plan(findings: Findings, candidates: Candidates, detector: Detector) -> dict[str, object]:
    """Return the provenance of a plan for plan.json: digests of all inputs, seeds and versions.

    Packages that are not installed have no version.

    candidates: candidates that were searched; detector: detector of the judgement."""
    question = findings.question
    setting = question.setting
    stock = question.stock
    keep_out = repr([area.wkt for area in stock.keep_out])
    versions = {"coview": coview_version(), "python": platform.python_version()}
    for name in TRACED_PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    traffic = {}
    for name, part in zip(PART_FRAMES, findings.traffic, strict=True):
        seed = question.part(name).seed
        traffic[name] = {"seed": seed, "frames": len(part), "sha256": part.digest()}
    return {
        "site": question.site.name,
        "site_sha256": sha256(format_site(question.site).encode()).hexdigest(),
        "poles_sha256": stock.poles_digest,
        "catalogue_sha256": None if stock.catalogue is None else stock.catalogue.digest,
        "keep_out_sha256": sha256(keep_out.encode()).hexdigest(),
        "candidates": candidates.digest(),
        **detector_origin(detector),
        "network": findings.network,
        "search_fidelity": findings.objective.fidelity,
        "classes": setting.counted.origin,
        "codec": setting.codec.digest,
        "errors": question.cases.errors_origin,
        "traffic": traffic,
        "bootstrap": {"draws": RESAMPLES, "block_frames": BLOCK_FRAMES, "seed": question.run.seed},
        "versions": versions,
    }
