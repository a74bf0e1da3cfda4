"""Provenance of figures: data, detector, settings and version."""

import hashlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from toolkit.detection.codec import Codec
from toolkit.objects import Detector


def coview_version() -> str:
    """Version of this installation, "unknown" if it is not installed."""
    try:
        return version("coview")
    except PackageNotFoundError:
        return "unknown"


def dataset_origin(dataset: object) -> dict[str, object]:
    """Name and path of a recording's file.

    A recording in memory has the name of its class, and no path (None)."""
    path = getattr(dataset, "path", None)
    return {
        "dataset": type(dataset).__name__ if path is None else Path(path).name,
        "dataset_path": path and str(path),  # None stays None
    }


def detector_origin(detector: Detector) -> dict[str, Any]:
    """Name and digest of a detector.

    The name is the one in commands, else the detector's kind; the digest is None if it has no
    digest."""
    name = getattr(detector, "name", getattr(detector, "__name__", type(detector).__name__))
    return {"detector": name, "detector_digest": getattr(detector, "digest", None)}


def settings_origin(codec: Codec, **settings: object) -> dict[str, object]:
    """Settings as given, with the codec's digest and the version of coview."""
    return {**settings, "codec": codec.digest, "coview": coview_version()}


def with_file_digest(origin: Mapping[str, object]) -> dict[str, object]:
    """Return an origin with the SHA-256 of the recording's file, None without a file.

    origin: describes a recording, with the path of its file as `dataset_path`; it is not
    changed."""
    path = origin.get("dataset_path")
    digest = None
    if isinstance(path, str) and path and Path(path).is_file():
        with Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {**origin, "dataset_sha256": digest}
