"""The loop: killed and gone on with it ends with the same weights; it learns; another run's folder is refused."""

from dataclasses import replace

import pytest
import torch

from models.training.log import LOG, curves
from models.training.loop import train
from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from models.training.presets import PRESETS, config_for
from models.training.samples import SampleRecipe
from models.training.validation import average_precision

AREA = (-12.8, -12.8, 12.8, 12.8)
FAST = replace(PRESETS["fast"], epochs=3.0)


class Stopped(Exception):
    pass


def stop_after(steps):
    def progress(step, total, figures):
        if step >= steps:
            raise Stopped

    return progress


@pytest.mark.parametrize(
    ("preset", "changes"),
    [
        ("fast", {}),
        ("general", {}),
        ("paper", {"vfe_widths": (4,), "voxel_width": 8, "head3x3": 8, "point_features": "published"}),
    ],
)
def test_stopped_anywhere_and_gone_on_with_gives_the_same_weights(packed_file, tmp_path, preset, changes, same_weights):
    settings = replace(PRESETS[preset], epochs=3.0, batch=2)
    config = replace(config_for(AREA, preset), **changes)
    undisturbed = train(packed_file, config, settings, tmp_path / "whole")
    for steps in (2, 4, 8):
        with pytest.raises(Stopped):
            train(packed_file, config, settings, tmp_path / "stopped", every_s=0.0, progress=stop_after(steps))
    resumed = train(packed_file, config, settings, tmp_path / "stopped", every_s=0.0)
    assert same_weights(undisturbed, resumed)
    assert (tmp_path / "whole" / LOG).read_bytes() == (tmp_path / "stopped" / LOG).read_bytes()
    again = train(packed_file, config, settings, tmp_path / "stopped")  # nothing left to do
    assert same_weights(undisturbed, again)


def test_another_seed_gives_other_weights_and_workers_the_same(packed_file, tmp_path, same_weights):
    config, settings = config_for(AREA, "fast"), replace(FAST, epochs=1.0)
    first = train(packed_file, config, settings, tmp_path / "a")
    helped = train(packed_file, config, settings, tmp_path / "b", workers=2)
    other = train(packed_file, config, replace(settings, seed=1), tmp_path / "c")
    assert same_weights(first, helped)
    assert not same_weights(first, other)


def test_a_folder_of_another_run_is_refused(packed_file, tmp_path):
    config = config_for(AREA, "fast")
    train(packed_file, config, replace(FAST, epochs=0.4), tmp_path)
    with pytest.raises(ValueError, match="another preset: choose another folder"):
        train(packed_file, config, replace(FAST, epochs=0.7), tmp_path)


def test_the_log_s_means_do_not_depend_on_where_a_training_was_killed(packed_file, tmp_path, monkeypatch):
    monkeypatch.setattr("models.training.loop.LOG_STEPS", 3)
    config, settings = config_for(AREA, "fast"), replace(FAST, epochs=2.0, batch=1)
    train(packed_file, config, settings, tmp_path / "whole")
    for steps in (2, 4):
        with pytest.raises(Stopped):
            train(packed_file, config, settings, tmp_path / "killed", every_s=0.0, progress=stop_after(steps))
    train(packed_file, config, settings, tmp_path / "killed", every_s=0.0)
    assert (tmp_path / "whole" / LOG).read_bytes() == (tmp_path / "killed" / LOG).read_bytes()
    assert len((tmp_path / "whole" / LOG).read_text().splitlines()) > 4


@pytest.mark.slow
def test_it_learns_two_frames_by_heart(frames, tmp_path):
    data = tmp_path / "two.packed"
    pack([recording(frames, AREA, count=2)], data)
    settings = replace(FAST, epochs=150.0, examples=SampleRecipe(subsets=0.0))
    network = train(data, config_for(AREA, "fast"), settings, tmp_path)
    ap = average_precision(network, PackedFrames(data), seed=9)
    assert ap["AP@0.7"] > 0.99
    assert ap["AP@0.8"] > 0.9


def test_it_goes_on_from_other_weights(packed_file, tmp_path):
    config, settings = config_for(AREA, "fast"), replace(FAST, epochs=0.4, learning_rate=1e-9)
    first = train(packed_file, config, replace(FAST, epochs=0.4), tmp_path / "first")
    second = train(packed_file, config, settings, tmp_path / "second", start=first)
    theirs = dict(first.named_parameters())
    assert all(torch.allclose(theirs[name], p, atol=1e-6) for name, p in second.named_parameters())
    with pytest.raises(ValueError, match="start"):
        train(packed_file, config, settings, tmp_path / "second")


def test_in_bfloat16_it_learns_as_well_and_is_another_run(packed_file, tmp_path):
    config, settings, figures = config_for(AREA, "fast"), replace(FAST, epochs=4.0), {}
    for bfloat16 in (False, True):
        train(packed_file, config, settings, tmp_path / str(bfloat16), bfloat16=bfloat16)
        figures[bfloat16] = curves(tmp_path / str(bfloat16) / LOG)["class"][1][-1]
    assert figures[True] == pytest.approx(figures[False], rel=0.1)
    assert figures[True] != figures[False]
    with pytest.raises(ValueError, match="another bfloat16"):
        train(packed_file, config, settings, tmp_path / "True")
