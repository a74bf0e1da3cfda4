import hashlib
from types import SimpleNamespace

from toolkit.detection.codec import PAPER
from toolkit.detection.provenance import (
    coview_version,
    dataset_origin,
    detector_origin,
    settings_origin,
    with_file_digest,
)
from toolkit.objects import Detections


def test_files_detectors_and_settings_are_named_with_digests(tmp_path):
    path = tmp_path / "tj.hdf5"
    path.write_bytes(b"frames")
    origin = with_file_digest(dataset_origin(SimpleNamespace(path=path)))
    assert origin == {
        "dataset": "tj.hdf5", "dataset_path": str(path), "dataset_sha256": hashlib.sha256(b"frames").hexdigest(),
    }  # fmt: skip
    path.unlink()
    assert with_file_digest(origin)["dataset_sha256"] is None
    origin = with_file_digest(dataset_origin([]))
    assert origin == {"dataset": "list", "dataset_path": None, "dataset_sha256": None}

    def nothing(points):
        return Detections.empty()

    assert detector_origin(nothing) == {"detector": "nothing", "detector_digest": None}
    nothing.digest = "abc"  # type: ignore[attr-defined]
    assert detector_origin(nothing)["detector_digest"] == "abc"
    assert settings_origin(PAPER, frames=3) == {"frames": 3, "codec": PAPER.digest, "coview": coview_version()}
