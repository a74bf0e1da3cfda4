"""The shipped weights detect on traffic they have not seen, and say where they come from."""

from pathlib import Path

import pytest

from models.detector import SHIPPED, load_detector
from models.weight_files import load_weights
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.evaluation import evaluate_dataset

WEIGHTS = sorted(Path(SHIPPED).glob("*.safetensors"))


@pytest.mark.parametrize("path", WEIGHTS, ids=lambda path: path.stem)
def test_the_header_says_where_they_come_from(path):
    _, header = load_weights(path)
    assert header.site == path.stem
    assert len(header.commit) >= 7
    assert header.ap["AP@0.7"] > 0.9


@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_they_detect_at_their_site_and_the_general_ones_at_both(site, tmp_path):
    simulate_dataset(site, frames=4, seed=31, out=tmp_path / "few.hdf5", workers=1)
    with CoopDataset(tmp_path / "few.hdf5") as recording:
        for name in (site, "general"):
            detector = load_detector(name, site=site, area=recording.site.area)
            (row,) = evaluate_dataset(recording, detector, schemes=("early",), iou_thresholds=(0.7,))
            assert row.ap > 0.9, name
