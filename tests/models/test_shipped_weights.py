"""The shipped weights detect on traffic they have not seen, and say where they come from."""

from pathlib import Path

import numpy as np
import pytest

from models.config import SHIPPED
from models.detector_loading import load_detector, load_site_detector
from models.weight_files import load_weights
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.runtime.run import Run
from toolkit.sites.files import load_site


@pytest.mark.parametrize(
    "path", sorted(Path(SHIPPED).rglob("*.safetensors")), ids=lambda path: path.stem
)
def test_the_header_says_where_they_come_from(path):
    _, header = load_weights(path)
    assert header.site == path.stem
    assert len(header.commit) >= 7
    assert header.ap["AP@0.7"] > 0.9


@pytest.mark.parametrize(
    ("site", "network"),
    [("tjunction", "tjunction"), ("roundabout", "roundabout"), ("mill-road", "general")],
)
def test_a_site_without_a_network_gets_the_general_one(site, network):
    has_network = site == network
    area = load_site(site).area if has_network else (-20.0, -16.0, 20.0, 16.0)
    detector = load_site_detector(site, area)
    assert detector.name == network
    assert tuple(detector.area) == tuple(area)


def street(seed=0, cars=8, half=18.0):
    """Points of flat ground and of some cuboids of the size of cars on it."""
    rng = np.random.default_rng(seed)
    parts = [np.column_stack([rng.uniform(-half, half, (6000, 2)), rng.normal(0.03, 0.015, 6000)])]
    for k in range(cars):
        size = rng.uniform([3.6, 1.6, 1.4], [5.2, 2.0, 1.9])
        u, face = rng.uniform(-0.5, 0.5, (400, 3)), rng.integers(0, 5, 400)
        for number, (axis, at) in enumerate([(0, 0.5), (0, -0.5), (1, 0.5), (1, -0.5), (2, 0.5)]):
            u[face == number, axis] = at
        (x, y, z), yaw = (u * size + [0, 0, size[2] / 2]).T, rng.uniform(-np.pi, np.pi)
        cos, sin = np.cos(yaw), np.sin(yaw)
        parts.append(np.column_stack([x * cos - y * sin, x * sin + y * cos, z]))
        parts[-1][:, :2] += [(k % 4 - 1.5) * 9, (k // 4 - 0.5) * 16]
    return np.concatenate(parts).astype(np.float32)


# what the weights that know vehicles alone detected before there were classes; on one machine to
# the byte
AS_EVER = {
    "vehicles/tjunction": (
        "0c46b2b5b1f32de78f13768ca7e21271614700e0b41f3fa02d1e038567a4ea44",
        [13.5842, 8.0343, 0.9988, 4.886, 2.0884, 2.003, 0.1763],
        [0.8558, 0.8044, 0.778, 0.7193, 0.713, 0.539, 0.4261, 0.385],
    ),
    "vehicles/roundabout": (
        "d7718df2636d40f25b03332db7d58066dc44600d3b778f51512f4f3241352ea2",
        [-13.5216, 7.9917, 0.9548, 4.4098, 2.0382, 1.9688, 0.3454],
        [0.8887, 0.877, 0.8719, 0.8698, 0.7713, 0.7002, 0.6916, 0.6759],
    ),
    "vehicles/general": (
        "747f128df5176c5a7e276ef5fe4008ba31be35b42537b6f707f6662c44f3c05d",
        [4.4811, 7.9995, 0.818, 4.7478, 2.0224, 1.6328, 4.3685],
        [0.8693, 0.8558, 0.8441, 0.8173, 0.7349, 0.7157, 0.7006, 0.6529],
    ),
}


@pytest.mark.parametrize("name", AS_EVER)
def test_they_detect_what_they_detected(name):
    digest, box, scores = AS_EVER[name]
    detector = load_detector(name, area=(-20, -20, 20, 20) if name.endswith("general") else None)
    found = detector(street())
    assert detector.digest == digest
    np.testing.assert_allclose(found.boxes[0], box, atol=2e-3)
    np.testing.assert_allclose(found.scores, scores, atol=1e-3)
    assert set(found.labels) == {0}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_they_detect_at_their_site_and_the_general_ones_at_both(site, tmp_path):
    simulate_dataset(site, tmp_path / "few.hdf5", run=Run(frames=4, seed=31))
    with CoopDataset(tmp_path / "few.hdf5") as recording:
        for name in (site, "general"):
            detector = load_detector(name, site=site, area=recording.site.area)
            (row,) = evaluate_recording(
                recording, detector, Comparison(schemes=("early",), iou_thresholds=(0.7,))
            )
            assert row.ap > 0.9, name
