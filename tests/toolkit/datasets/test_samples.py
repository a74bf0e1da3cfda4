import numpy as np
import pytest

import toolkit.datasets
from toolkit.datasets.records.labels import add_problems
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.datasets.samples import open_samples, read, write_samples
from toolkit.objects import Objects


@pytest.fixture
def folder(tmp_path):
    boxes = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5], [9.0, 2, 3, 2, 1, 1.5, 0.5]])
    cloud = SensorCloud("s", np.array([[1, 1, 1], [0, 0, 0]], np.float32), np.eye(4))
    samples = [Sample(str(k), (cloud,), Objects(boxes, np.array([0, 1]))) for k in range(3)]
    assert write_samples(samples, tmp_path, "folder") == 3
    return tmp_path


def test_a_recording_is_read_one_by_one(folder):
    samples = read(folder, "folder")
    assert iter(samples) is samples
    assert [sample.name for sample in samples] == ["000000", "000001", "000002"]
    assert len(open_samples(str(folder), "folder")) == 3
    assert toolkit.datasets.read is read


def test_some_classes(folder):
    assert [sample.objects.labels.tolist() for sample in read(folder, "folder", classes=["cyclist"])] == [[1]] * 3
    assert [sample.objects.labels.tolist() for sample in read(folder, "folder", classes=[0, 1])] == [[0, 1]] * 3
    with pytest.raises(ValueError, match="label must be one of"):
        read(folder, "folder", classes=["dog"])


def test_problems_are_added_up(folder):
    total: dict[str, int] = {}
    for sample in read(folder, "folder"):
        add_problems(total, sample.problems)
    assert total == {"points of no return": 3}


def test_what_is_not_there_or_only_read(folder):
    with pytest.raises(FileNotFoundError, match="no such recording"):
        read(folder / "other", "folder")
    with pytest.raises(ValueError, match="no layout 'x'"):
        read(folder, "x")
    with pytest.raises(ValueError, match="layout rcooper is only read"):
        write_samples([], folder, "rcooper")
