"""Training: killed and gone on with it ends with the same weights; it learns; what it writes is whole."""

import os
import random
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from models import training_log
from models.config import VoxelNetConfig
from models.packed import PackedFrames
from models.packing import pack, recording
from models.samples import SampleRecipe
from models.train import ANYWHERE, CHECKPOINT, LOG, PRESETS, area_for, config_for, load_checkpoint, train
from models.validation import average_precision, validation
from models.weights import load_weights

AREA = (-12.8, -12.8, 12.8, 12.8)
FAST = replace(PRESETS["fast"], epochs=3.0)
REPOSITORY = Path(__file__).parents[2]


class Stopped(Exception):
    pass


def stop_after(steps):
    def progress(step, total, figures):
        if step >= steps:
            raise Stopped

    return progress


def same_weights(a, b):
    a, b = a.state_dict(), b.state_dict()
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize(
    ("preset", "changes"),
    [
        ("fast", {}),
        ("general", {}),
        ("paper", {"vfe_widths": (4,), "voxel_width": 8, "head3x3": 8, "point_features": "published"}),
    ],
)
def test_stopped_anywhere_and_gone_on_with_gives_the_same_weights(packed_file, tmp_path, preset, changes):
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


def test_another_seed_gives_other_weights_and_workers_the_same(packed_file, tmp_path):
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


def test_a_preset_needs_the_head_of_its_loss(packed_file, tmp_path):
    with pytest.raises(ValueError, match="published loss"):
        train(packed_file, VoxelNetConfig.light(AREA), PRESETS["paper"], tmp_path)


def test_a_checkpoint_is_loaded_with_its_settings(packed_file, tmp_path):
    network = train(packed_file, config_for(AREA, "fast"), replace(FAST, epochs=0.4), tmp_path)
    loaded, settings = load_checkpoint(tmp_path / CHECKPOINT)
    assert same_weights(network, loaded)
    assert loaded.config == network.config
    assert settings["step"] == 1
    assert settings["preset"]["learning_rate"] == FAST.learning_rate


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_checkpoint_that_was_cut_is_told_in_one_line(packed_file, tmp_path, share):
    config, settings, path = config_for(AREA, "fast"), replace(FAST, epochs=0.4), tmp_path / CHECKPOINT
    train(packed_file, config, settings, tmp_path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    for read in (lambda: load_checkpoint(path), lambda: train(packed_file, config, settings, tmp_path)):
        with pytest.raises(ValueError, match=r"checkpoint.pt is damaged or no checkpoint \(.*\): remove it") as told:
            read()
        assert "\n" not in str(told.value)


@pytest.mark.parametrize("state", [7, {}, {"network": {}}, {"config": 3}])
def test_what_is_no_checkpoint_is_told_in_one_line(packed_file, tmp_path, state):
    torch.save(state, tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match="is no checkpoint") as told:
        load_checkpoint(tmp_path / CHECKPOINT)
    assert "\n" not in str(told.value)
    with pytest.raises(ValueError, match=r"is no checkpoint|another config"):
        train(packed_file, config_for(AREA, "fast"), FAST, tmp_path)


def test_the_log_s_means_do_not_depend_on_where_a_training_was_killed(packed_file, tmp_path, monkeypatch):
    monkeypatch.setattr("models.train.LOG_STEPS", 3)
    config, settings = config_for(AREA, "fast"), replace(FAST, epochs=2.0, batch=1)
    train(packed_file, config, settings, tmp_path / "whole")
    for steps in (2, 4):
        with pytest.raises(Stopped):
            train(packed_file, config, settings, tmp_path / "killed", every_s=0.0, progress=stop_after(steps))
    train(packed_file, config, settings, tmp_path / "killed", every_s=0.0)
    assert (tmp_path / "whole" / LOG).read_bytes() == (tmp_path / "killed" / LOG).read_bytes()
    assert len((tmp_path / "whole" / LOG).read_text().splitlines()) > 4


def test_the_area_is_that_of_the_data_or_a_window(packed_file):
    assert area_for("fast", packed_file) == AREA
    assert area_for("general", packed_file) == ANYWHERE


def test_validation_leaves_training_undisturbed(packed_file, tmp_path):
    config, settings = config_for(AREA, "fast"), replace(FAST, epochs=2.0)
    plain = train(packed_file, config, settings, tmp_path / "plain")
    measured = train(packed_file, config, settings, tmp_path / "ap", validate=validation(packed_file, count=2))
    assert same_weights(plain, measured)
    assert plain.training
    epochs, values = training_log.curves(tmp_path / "ap" / LOG)["AP@0.7"]
    assert epochs == [1.0, 2.0]
    assert all(0 <= value <= 1 for value in values)


def test_a_log_forgets_what_came_after_the_checkpoint(tmp_path):
    path = tmp_path / "log.csv"
    training_log.cut(path, 5)
    for step in (5, 10, 15):
        training_log.add(path, step, step / 10, {"box": 1.0 / step})
    with path.open("a") as file:
        file.write("20,2.0,bo")  # killed in the middle of a line
    training_log.cut(path, 10)
    assert training_log.curves(path) == {"box": ([0.5, 1.0], [0.2, 0.1])}
    path.write_text("")
    training_log.cut(path, 10)
    training_log.add(path, 1, 0.1, {"box": 1.0})
    assert training_log.curves(path) == {"box": ([0.1], [1.0])}


def test_the_command_leaves_weights_and_curves(packed_file, tmp_path):
    from coview.main import main

    options = ["--data", str(packed_file), "--epochs", "0.4", "--device", "cpu", "--out", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        main(["train", "general", *options, "--validate", str(packed_file), "--validate-frames", "1", "--json"])
    assert ended.value.code == 0
    network, header = load_weights(tmp_path / "weights.safetensors")
    assert same_weights(network, load_checkpoint(tmp_path / CHECKPOINT)[0])
    assert header.site == "general"
    assert set(header.ap) == {"AP@0.7", "AP@0.8", "AP@0.9"}
    assert {"losses.png", "ap.png"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_it_learns_two_frames_by_heart(frames, tmp_path):
    data = tmp_path / "two.packed"
    pack([recording(frames, AREA, count=2)], data)
    settings = replace(FAST, epochs=150.0, examples=SampleRecipe(subsets=0.0))
    network = train(data, config_for(AREA, "fast"), settings, tmp_path)
    ap = average_precision(network, PackedFrames(data), seed=9)
    assert ap["AP@0.7"] > 0.99
    assert ap["AP@0.8"] > 0.9


@pytest.mark.slow
def test_killed_three_times_it_ends_with_the_same_weights(packed_file, tmp_path):
    command = [sys.executable, "-m", "models.train", "--data", str(packed_file), "--epochs", "20", "--threads", "1"]
    command += ["--device", "cpu", "--checkpoint-s", "0.3", "--out"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    random.seed(0)
    for kills in range(3):
        process = subprocess.Popen([*command, str(tmp_path / "killed")], env=environment, stdout=subprocess.DEVNULL)
        while not (tmp_path / "killed" / CHECKPOINT).exists():
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(random.uniform(0.5, 3.0) + 2.0 * bool(kills))
        process.kill()
        assert process.wait() == -9, "it was done before it was killed: give it more epochs"
    for folder in ("killed", "whole"):
        subprocess.run([*command, str(tmp_path / folder)], env=environment, check=True, stdout=subprocess.DEVNULL)
    killed, whole = (load_checkpoint(tmp_path / folder / CHECKPOINT)[0] for folder in ("killed", "whole"))
    assert same_weights(killed, whole)


def test_it_goes_on_from_other_weights(packed_file, tmp_path):
    config, settings = config_for(AREA, "fast"), replace(FAST, epochs=0.4, learning_rate=1e-9)
    first = train(packed_file, config, replace(FAST, epochs=0.4), tmp_path / "first")
    second = train(packed_file, config, settings, tmp_path / "second", start=first)
    theirs = dict(first.named_parameters())
    assert all(torch.allclose(theirs[name], p, atol=1e-6) for name, p in second.named_parameters())
    with pytest.raises(ValueError, match="start"):
        train(packed_file, config, settings, tmp_path / "second")
