"""Checkpoints: whole under their name, read without executing anything, damage named in one line."""

from dataclasses import replace

import pytest
import torch

from models.training.checkpoint import CHECKPOINT, check_identity, load_checkpoint, read_checkpoint, save_atomically
from models.training.loop import train
from models.training.presets import PRESETS, config_for

AREA = (-12.8, -12.8, 12.8, 12.8)
FAST = replace(PRESETS["fast"], epochs=3.0)


def test_a_checkpoint_is_loaded_with_its_settings(packed_file, tmp_path, same_weights):
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
        with pytest.raises(
            ValueError, match=r"checkpoint.pt is damaged or no checkpoint of tensors alone: .*: remove it"
        ) as told:
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


class Harmful:
    def __reduce__(self):
        return print, ("executed",)


def test_a_training_that_goes_on_executes_nothing_of_its_checkpoint(packed_file, tmp_path, capsys):
    torch.save({"config": Harmful()}, tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match="is damaged or no checkpoint"):
        train(packed_file, config_for(AREA, "fast"), FAST, tmp_path)
    assert "executed" not in capsys.readouterr().out


def test_what_is_saved_is_read_and_nothing_else_is_left_beside_it(tmp_path):
    path = tmp_path / CHECKPOINT
    for step in (1, 2):
        save_atomically(path, {"step": step, "weights": torch.arange(3)})
        state = read_checkpoint(path)
        assert state["step"] == step
        assert state["weights"].tolist() == [0, 1, 2]
    assert list(tmp_path.iterdir()) == [path]


def test_settings_are_the_same_after_a_round_trip_and_others_are_named(tmp_path):
    identity = {"config": {"area": (1.0, 2.0)}, "preset": {"seed": 0}, "start": ""}
    read = {"config": {"area": [1.0, 2.0]}, "preset": {"seed": 0}}  # a run of old, which knew no start
    check_identity(tmp_path, read, identity)
    with pytest.raises(ValueError, match="another preset and start: choose another folder"):
        check_identity(tmp_path, read, {**identity, "preset": {"seed": 1}, "start": "abc"})
