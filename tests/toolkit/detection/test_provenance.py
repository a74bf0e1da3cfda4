import hashlib
from types import SimpleNamespace

from toolkit.detection import codec, provenance
from toolkit.objects import Detections


def test_files_detectors_and_settings_are_named_with_digests(tmp_path):
    path = tmp_path / "tj.hdf5"
    path.write_bytes(b"frames")
    origin = provenance.with_file_digest(provenance.dataset_origin(SimpleNamespace(path=path)))
    assert origin == {
        "dataset": "tj.hdf5",
        "dataset_path": str(path),
        "dataset_sha256": hashlib.sha256(b"frames").hexdigest(),
    }
    path.unlink()
    assert provenance.with_file_digest(origin)["dataset_sha256"] is None
    origin = provenance.with_file_digest(provenance.dataset_origin([]))
    assert origin == {"dataset": "list", "dataset_path": None, "dataset_sha256": None}

    def nothing(points):
        return Detections.empty()

    assert provenance.detector_origin(nothing) == {"detector": "nothing", "detector_digest": None}
    nothing.digest = "abc"  # type: ignore[attr-defined]
    assert provenance.detector_origin(nothing)["detector_digest"] == "abc"
    assert provenance.settings_origin(codec.PAPER, frames=3) == {
        "frames": 3,
        "codec": codec.PAPER.digest,
        "coview": provenance.coview_version(),
    }
