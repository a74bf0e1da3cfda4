"""`coview train` and `python -m models.train`: weights and curves, the same ones however often they
were killed."""

import os
import random
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from coview.main import main
from models.config import VoxelNetConfig, road_users
from models.network.voxelnet import VoxelNet
from models.train import WEIGHTS, commit, run_training, second_stages
from models.training.loop import CHECKPOINT
from models.training.options import TrainingOptions
from models.training.second_stage import widen
from models.weight_files import load_weights, read_checkpoint

REPOSITORY = Path(__file__).parents[2]


def test_the_command_leaves_weights_and_curves(packed_file, tmp_path, same_weights):
    options = [
        "--data",
        str(packed_file),
        "--epochs",
        "0.4",
        "--device",
        "cpu",
        "--out",
        str(tmp_path),
    ]
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "train",
                "general",
                *options,
                "--validate",
                str(packed_file),
                "--validate-frames",
                "1",
                "--json",
            ]
        )
    assert ended.value.code == 0
    network, header = load_weights(tmp_path / "weights.safetensors")
    assert same_weights(network, read_checkpoint(tmp_path / CHECKPOINT)["network"])
    assert header.site == "general"
    assert set(header.ap) == {"AP@0.7", "AP@0.8", "AP@0.9"}
    assert {"losses.png", "ap.png"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_classes_faces_and_calibration_are_trained_in_one_run(packed_file, tmp_path, limits):
    limits("models.training.second_stage", FACE_STEPS=20)
    chosen = {
        "classes": ("vehicle", "heavy"),
        "faces": ("vehicle",),
        "calibrate": True,
        "start": "general",
    }
    options = TrainingOptions(
        data=packed_file,
        out=tmp_path / "a",
        epochs=1.0,
        batch=2,
        device="cpu",
        validate=packed_file,
        **chosen,
    )
    weights, figures = run_training(None, options)
    network, header = load_weights(weights)
    assert network.config.labels == ("vehicle", "heavy")
    assert network.config.faces == ("vehicle",)
    assert len(network.config.calibration) == 2
    assert {"AP@0.7", "AP@0.9", "heavy AP@0.5"} <= header.ap.keys()
    assert header.ap == figures
    np.testing.assert_array_less(network.faces.prior, np.inf)
    again, _ = load_weights(run_training(None, replace(options, out=tmp_path / "b"))[0])
    for name, tensor in network.state_dict().items():
        assert torch.equal(again.state_dict()[name], tensor)
    assert again.config == network.config


@pytest.mark.slow
def test_killed_three_times_it_ends_with_the_same_weights(packed_file, tmp_path, same_weights):
    command = [
        sys.executable,
        "-m",
        "models.train",
        "--data",
        str(packed_file),
        "--epochs",
        "20",
        "--threads",
        "1",
    ]
    command += ["--device", "cpu", "--checkpoint-s", "0.3", "--out"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    random.seed(0)
    for kills in range(3):
        process = subprocess.Popen(
            [*command, str(tmp_path / "killed")], env=environment, stdout=subprocess.DEVNULL
        )
        while not (tmp_path / "killed" / CHECKPOINT).exists():
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(random.uniform(0.5, 3.0) + 2.0 * bool(kills))
        process.kill()
        assert process.wait() == -9, "it was done before it was killed: give it more epochs"
    for folder in ("killed", "whole"):
        subprocess.run(
            [*command, str(tmp_path / folder)],
            env=environment,
            check=True,
            stdout=subprocess.DEVNULL,
        )
    killed, whole = (
        read_checkpoint(tmp_path / folder / CHECKPOINT)["network"] for folder in ("killed", "whole")
    )
    assert same_weights(killed, whole)


def test_weights_that_no_training_here_made_are_kept(packed_file, tmp_path):
    (tmp_path / WEIGHTS).write_text("somebody's")
    options = TrainingOptions(data=packed_file, out=tmp_path, epochs=0.4, device="cpu")
    with pytest.raises(FileExistsError):
        run_training("general", options)
    assert (tmp_path / WEIGHTS).read_text() == "somebody's"


def test_weights_know_the_commit_of_the_code_that_made_them(environment):
    assert commit() == "unknown" or len(commit()) == 40
    environment(PATH="")
    assert commit() == "unknown"


def test_what_is_left_out_is_as_in_the_network_that_training_starts_from(tmp_path):
    four = VoxelNetConfig.light(
        (-8, -8, 8, 8),
        **road_users(),
        faces=("vehicle", "heavy"),
        calibration=((1.0, 0.0),) * 4,
        thresholds=(0.2,) * 4,
    )
    start = VoxelNet(four)
    given = {"data": tmp_path, "out": tmp_path, "start": "general"}
    assert second_stages(TrainingOptions(**given), start) == (
        four.labels,
        ("vehicle", "heavy"),
        True,
    )
    fewer = TrainingOptions(**given, classes=("heavy", "cyclist"))
    assert second_stages(fewer, start) == (("heavy", "cyclist"), ("heavy",), True)
    assert second_stages(TrainingOptions(**given, faces=()), start)[1] == ()
    assert second_stages(TrainingOptions(data=tmp_path, out=tmp_path), None) == (
        ("vehicle",),
        (),
        False,
    )
    with pytest.raises(
        ValueError,
        match="--faces must be among --classes vehicle heavy cyclist pedestrian, got tram",
    ):
        second_stages(TrainingOptions(**given, faces=("tram",)), start)
    one = widen(start, VoxelNetConfig.light((-8, -8, 8, 8)))
    assert (one.config.labels, one.config.thresholds, one.config.faces) == (("vehicle",), (), ())
