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


def test_a_file_is_named_with_its_digest(tmp_path):
    path = tmp_path / "tj.hdf5"
    path.write_bytes(b"frames")
    origin = with_file_digest(dataset_origin(SimpleNamespace(path=path)))
    assert origin == {
        "dataset": "tj.hdf5", "dataset_path": str(path), "dataset_sha256": hashlib.sha256(b"frames").hexdigest(),
    }  # fmt: skip
    path.unlink()
    assert with_file_digest(origin)["dataset_sha256"] is None


def test_what_is_in_memory_alone_has_no_file():
    origin = with_file_digest(dataset_origin([]))
    assert origin == {"dataset": "list", "dataset_path": None, "dataset_sha256": None}


def test_detectors_with_and_without_digest():
    def nothing(points):
        return Detections.empty()

    assert detector_origin(nothing) == {"detector": "nothing", "detector_digest": None}
    nothing.digest = "abc"  # type: ignore[attr-defined]
    assert detector_origin(nothing)["detector_digest"] == "abc"


def test_settings_name_codec_and_version():
    assert settings_origin(PAPER, frames=3) == {"frames": 3, "codec": PAPER.digest, "coview": coview_version()}
