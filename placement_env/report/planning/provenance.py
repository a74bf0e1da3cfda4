"""Provenance of a plan: digests of all its inputs, seeds and versions; nothing of it depends on the clock."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from placement_env.analysis.intervals import BLOCK_FRAMES, RESAMPLES
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.traffic import Traffic
from placement_env.report.planning.question import Question
from toolkit.detection.provenance import coview_version, detector_origin
from toolkit.objects import Detector
from toolkit.sites.files import format_site

PACKAGES = ("numpy", "torch", "open3d-cpu", "open3d", "eclipse-sumo", "libsumo", "ortools", "shapely")


def plan_origin(
    question: Question,
    candidates: Candidates,
    traffic: Sequence[Traffic],
    detector: Detector,
    *,
    network: str,
    search_fidelity: str,
) -> dict[str, Any]:
    """Where all figures of a plan come from. traffic: of the searches, the comparison and the judgement."""
    parts = ("search", "comparison", "judgement")
    return {
        "site": question.site.name,
        "site_sha256": sha256(format_site(question.site).encode()).hexdigest(),
        "poles_sha256": question.poles_digest,
        "catalogue_sha256": None if question.catalogue is None else question.catalogue.digest,
        "keep_out_sha256": sha256(repr([area.wkt for area in question.keep_out]).encode()).hexdigest(),
        "candidates": candidates.digest(),
        **detector_origin(detector),
        "network": network,
        "search_fidelity": search_fidelity,
        "classes": question.classes.origin,
        "codec": question.codec.digest,
        "errors": question.cases.errors_origin,
        "traffic": {
            name: {"seed": question.seed + i, "frames": len(each), "sha256": each.digest()}
            for i, (name, each) in enumerate(zip(parts, traffic, strict=True))
        },
        "bootstrap": {"draws": RESAMPLES, "block_frames": BLOCK_FRAMES, "seed": question.seed},
        "versions": {"coview": coview_version(), "python": platform.python_version(), **_versions()},
    }


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
