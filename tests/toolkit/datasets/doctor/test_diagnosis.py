"""The doctor on healthy recordings, on files it cannot read and on tables that are damaged."""

import numpy as np
import pytest

from toolkit.datasets.doctor.diagnosis import diagnose


def replaced(name, content):
    def change(file):
        del file[name]
        file[name] = content(file) if callable(content) else content

    return change


def nothing(file):
    pass


@pytest.mark.parametrize("published", [False, True])
def test_a_healthy_recording_has_no_findings(spoil, published):
    assert spoil(nothing, published) == []


@pytest.mark.parametrize(
    ("change", "suspected", "where"),
    [
        (replaced("objects/3", np.zeros((0, 10))), "frames without objects", "objects/3"),
        (replaced("objects/3", lambda file: file["objects/5"][()]), "duplicated frames", "objects/5"),
        (replaced("objects/3", np.zeros((4, 7))), "damaged objects", "objects/3"),
        (replaced("objects/3", np.full((1, 10), np.nan)), "damaged objects", "objects/3"),
        (replaced("objects/3", np.zeros((1, 10))), "damaged objects", "objects/3"),
        (replaced("objects/3", np.full((4, 10), b"x")), "damaged objects", "objects/3"),
        (replaced("dslices", np.zeros((0, 2, 300, 400), np.float32)), "it cannot be read", "recording.hdf5"),
        (replaced("cameras", np.eye(4)), "it cannot be read", "recording.hdf5"),
        (lambda file: file["objects"].__delitem__("3"), "damaged objects", "objects/3"),
        (replaced("cameras/d00/extrinsic", np.zeros((4, 4))), "it cannot be read", "recording.hdf5"),
        (replaced("cameras/d00/extrinsic", np.full((4, 4), np.nan)), "it cannot be read", "recording.hdf5"),
    ],
)
def test_damage(spoil, change, suspected, where):
    findings = spoil(change)
    assert any(suspected in finding.suspected and where in finding.where for finding in findings)


def test_files_that_cannot_be_read(tmp_path, healthy):
    path = tmp_path / "recording.hdf5"
    with pytest.raises(FileNotFoundError):
        diagnose(path)
    for content, says in (
        (b"", "is empty"),
        (b"text" * 99, "not an HDF5 file"),
        (healthy[: len(healthy) // 2], "cut off"),
    ):
        path.write_bytes(content)
        (finding,) = diagnose(path)
        assert says in finding.evidence
