"""The loop: killed and gone on with it ends with the same weights; it learns; another run's folder
is refused."""

import shutil
from dataclasses import replace

import pytest
import torch

from models.config import VoxelNetConfig
from models.training import loop, presets, training_log
from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from models.training.preset import check_fit
from models.training.samples import SampleRecipe
from models.training.second_stage import compute_recording_ap
from models.training.state import TrainingState
from models.weight_files import read_checkpoint, save_atomically

AREA = (-12.8, -12.8, 12.8, 12.8)
FAST = replace(presets.PRESETS["fast"], epochs=3.0)
OFTEN = loop.Machine(checkpoint_s=0.0)


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
        pytest.param("general", {}, marks=pytest.mark.slow),
        pytest.param(
            *(
                "paper",
                {"vfe_widths": (4,), "voxel_width": 8, "head3x3": 8, "point_features": "published"},
            ),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_stopped_anywhere_and_gone_on_with_gives_the_same_weights(
    packed_file, tmp_path, preset, changes, same_weights
):
    settings = replace(presets.PRESETS[preset], epochs=3.0, batch=2)
    config = replace(presets.make_config(AREA, preset), **changes)
    undisturbed = loop.train(packed_file, config, settings, tmp_path / "whole")
    for steps in (2, 4, 8):
        with pytest.raises(Stopped):
            loop.train(
                packed_file,
                config,
                settings,
                tmp_path / "stopped",
                machine=OFTEN,
                progress=stop_after(steps),
            )
    resumed = loop.train(packed_file, config, settings, tmp_path / "stopped", machine=OFTEN)
    assert same_weights(undisturbed, resumed)
    assert (tmp_path / "whole" / training_log.LOG).read_bytes() == (
        tmp_path / "stopped" / training_log.LOG
    ).read_bytes()
    again = loop.train(packed_file, config, settings, tmp_path / "stopped")  # nothing left to do
    assert same_weights(undisturbed, again)


@pytest.mark.slow
def test_another_seed_gives_other_weights_and_workers_the_same(packed_file, tmp_path, same_weights):
    config, settings = presets.make_config(AREA, "fast"), replace(FAST, epochs=1.0)
    first = loop.train(packed_file, config, settings, tmp_path / "a")
    helped = loop.train(
        packed_file, config, settings, tmp_path / "b", machine=loop.Machine(workers=2)
    )
    other = loop.train(packed_file, config, replace(settings, seed=1), tmp_path / "c")
    assert same_weights(first, helped)
    assert not same_weights(first, other)


def test_folders_of_other_runs_and_heads_that_do_not_fit_are_refused(packed_file, tmp_path):
    config = presets.make_config(AREA, "fast")
    loop.train(packed_file, config, replace(FAST, epochs=0.4), tmp_path)
    with pytest.raises(ValueError, match="another preset: choose another folder"):
        loop.train(packed_file, config, replace(FAST, epochs=0.7), tmp_path)
    assert presets.choose_area("fast", packed_file) == AREA
    assert presets.choose_area("general", packed_file) == presets.ANYWHERE
    with pytest.raises(ValueError, match="published loss"):
        loop.train(packed_file, VoxelNetConfig.light(AREA), presets.PRESETS["paper"], tmp_path)


@pytest.mark.slow
def test_the_log_s_means_do_not_depend_on_where_a_training_was_killed(
    packed_file, tmp_path, limits
):
    limits("models.training.loop", LOG_STEPS=3)
    config, settings = presets.make_config(AREA, "fast"), replace(FAST, epochs=2.0, batch=1)
    loop.train(packed_file, config, settings, tmp_path / "whole")
    for steps in (2, 4):
        with pytest.raises(Stopped):
            loop.train(
                packed_file,
                config,
                settings,
                tmp_path / "killed",
                machine=OFTEN,
                progress=stop_after(steps),
            )
    loop.train(packed_file, config, settings, tmp_path / "killed", machine=OFTEN)
    assert (tmp_path / "whole" / training_log.LOG).read_bytes() == (
        tmp_path / "killed" / training_log.LOG
    ).read_bytes()
    assert len((tmp_path / "whole" / training_log.LOG).read_text().splitlines()) > 4


class Clock:
    """A clock on which every look takes a second."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr("models.training.loop.time.monotonic", self)

    def __call__(self):
        self.now += 1.0
        return self.now


@pytest.mark.slow
def test_a_training_of_seconds_ends_its_cycle_with_the_clock(packed_file, tmp_path, monkeypatch):
    config, machine = (
        presets.make_config(AREA, "fast"),
        loop.Machine(seconds=60.0, checkpoint_s=0.0),
    )
    rates, totals = [], []

    def watch(step, total, figures):
        totals.append((step, total))

    learn = TrainingState.learn

    def record(state, *arguments, **options):
        rates.append(state.scheduler.get_last_lr()[0])
        return learn(state, *arguments, **options)

    monkeypatch.setattr(TrainingState, "learn", record)
    clock = Clock(monkeypatch)
    loop.train(packed_file, config, FAST, tmp_path / "whole", machine=machine, progress=watch)
    assert clock.now == pytest.approx(60, abs=4)
    assert totals[-1][0] == totals[-1][1] == len(rates) > 10
    assert all(step < total for step, total in totals[:-1])
    highest = int(torch.tensor(rates).argmax())
    assert rates[highest] == pytest.approx(FAST.learning_rate, rel=0.05)
    assert highest / len(rates) == pytest.approx(0.2, abs=0.1)
    assert rates[-1] < 0.05 * FAST.learning_rate
    before, clock.now = len(rates), 0.0
    with pytest.raises(Stopped):
        loop.train(
            packed_file, config, FAST, tmp_path / "two", machine=machine, progress=stop_after(9)
        )
    half, clock.now = len(rates) - before, 0.0
    loop.train(packed_file, config, FAST, tmp_path / "two", machine=machine)
    assert half == 9
    assert len(rates) - before == pytest.approx(before, abs=3)
    assert clock.now < 60 - half
    done = len(rates)
    loop.train(packed_file, config, FAST, tmp_path / "two", machine=machine)  # nothing left to do
    assert len(rates) == done
    with pytest.raises(ValueError, match="another seconds"):
        loop.train(packed_file, config, FAST, tmp_path / "two", machine=loop.Machine(seconds=61.0))
    with pytest.raises(ValueError, match="schedule of one cycle"):
        loop.train(
            packed_file, config, presets.PRESETS["paper"], tmp_path / "paper", machine=machine
        )


@pytest.mark.slow
def test_it_learns_two_frames_by_heart(frames, tmp_path):
    data = tmp_path / "two.packed"
    pack([recording(frames, AREA, count=2)], data)
    settings = replace(FAST, epochs=300.0, examples=SampleRecipe(subsets=0.0))
    network = loop.train(data, presets.make_config(AREA, "fast"), settings, tmp_path)
    ap = compute_recording_ap(network, PackedFrames(data), seed=9)
    assert ap["AP@0.7"] > 0.99
    assert ap["AP@0.8"] > 0.9


@pytest.mark.slow
def test_it_goes_on_from_other_weights_and_learns_in_bfloat16(packed_file, tmp_path):
    config, settings = (
        presets.make_config(AREA, "fast"),
        replace(FAST, epochs=0.4, learning_rate=1e-9),
    )
    first = loop.train(packed_file, config, replace(FAST, epochs=0.4), tmp_path / "first")
    second = loop.train(packed_file, config, settings, tmp_path / "second", start=first)
    theirs = dict(first.named_parameters())
    assert all(torch.allclose(theirs[name], p, atol=1e-6) for name, p in second.named_parameters())
    with pytest.raises(ValueError, match="start"):
        loop.train(packed_file, config, settings, tmp_path / "second")
    config, settings, figures = presets.make_config(AREA, "fast"), replace(FAST, epochs=1.0), {}
    for bfloat16 in (False, True):
        loop.train(
            packed_file,
            config,
            settings,
            tmp_path / str(bfloat16),
            machine=loop.Machine(bfloat16=bfloat16),
        )
        figures[bfloat16] = training_log.read_curves(tmp_path / str(bfloat16) / training_log.LOG)[
            "class"
        ][1][-1]
    assert figures[True] == pytest.approx(figures[False], rel=0.1)
    assert figures[True] != figures[False]
    with pytest.raises(ValueError, match="another bfloat16"):
        loop.train(packed_file, config, settings, tmp_path / "True")


def test_data_of_two_areas_needs_a_site(frames, tmp_path):
    data = tmp_path / "two.packed"
    pack([recording(frames, AREA, count=1), recording(frames, (-5, -5, 5, 5), count=1)], data)
    with pytest.raises(ValueError, match="2 different areas: give a site, or general"):
        presets.choose_area("fast", data)


@pytest.mark.parametrize("size", ["light", "published"])
@pytest.mark.parametrize("preset", presets.PRESETS)
def test_every_preset_has_a_network_that_its_loss_trains(preset, size):
    check_fit(presets.make_config(AREA, preset, size), presets.PRESETS[preset])


def test_networks_of_classes_and_wide_areas():
    assert presets.make_config((0.0, 0.0, 40.0, 80.0), "paper", "published").voxel_size == (
        0.2,
        0.2,
        0.4,
    )
    assert presets.make_config((-48.0, -48.0, 48.0, 48.0), "paper", "published").voxel_size == (
        0.4,
        0.4,
        0.4,
    )
    assert presets.window((-48.0, 0.0, 48.0, 10.0)) == (
        -presets.WINDOW_M / 2,
        0.0,
        presets.WINDOW_M / 2,
        10.0,
    )
    config = presets.make_config(AREA, "varied", classes=("vehicle", "pedestrian"))
    assert config.labels == ("vehicle", "pedestrian")
    assert config.anchor_labels == (0, 0, 1)
    assert presets.make_config(AREA, "varied", classes=("vehicle",)) == presets.make_config(
        AREA, "fast"
    )
    shared = VoxelNetConfig.light(AREA, labels=("vehicle", "cyclist"))
    with pytest.raises(ValueError, match="an anchor kind each"):
        check_fit(shared, presets.PRESETS["fast"])


def test_windows_divide_the_batch_into_frames_that_are_read():
    config, four = (
        presets.make_config(AREA, "fast"),
        replace(presets.PRESETS["fast"].examples, windows=4),
    )
    preset = replace(presets.PRESETS["fast"], batch=12, examples=four)
    check_fit(config, preset)
    assert preset.readings == 3
    with pytest.raises(ValueError, match="windows must divide the batch, got 4 for 6 examples"):
        check_fit(config, replace(preset, batch=6))


@pytest.mark.parametrize("changes", [{"batch": 0}, {"epochs": 0.0}, {"epochs": float("nan")}])
def test_what_trains_nothing_is_refused(changes):
    with pytest.raises(ValueError, match="batch of at least 1 and epochs above 0"):
        check_fit(presets.make_config(AREA, "fast"), replace(presets.PRESETS["fast"], **changes))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_checkpoint_that_was_cut_is_told_in_one_line(packed_file, tmp_path, share):
    config, settings, path = (
        presets.make_config(AREA, "fast"),
        replace(FAST, epochs=0.4),
        tmp_path / loop.CHECKPOINT,
    )
    loop.train(packed_file, config, settings, tmp_path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    with pytest.raises(
        ValueError, match=r"checkpoint.pt is damaged or not a checkpoint of tensors: .*: remove it"
    ) as told:
        loop.train(packed_file, config, settings, tmp_path)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("state", [7, {}, {"network": {}}, {"config": 3}])
def test_what_is_no_checkpoint_is_told_in_one_line(packed_file, tmp_path, state):
    torch.save(state, tmp_path / loop.CHECKPOINT)
    with pytest.raises(ValueError, match=r"is not a checkpoint|another config") as told:
        loop.train(packed_file, presets.make_config(AREA, "fast"), FAST, tmp_path)
    assert "\n" not in str(told.value)


@pytest.fixture(scope="module")
def short_training(packed_file, tmp_path_factory):
    """Network, settings and folder of a training that is over."""
    config, settings = presets.make_config(AREA, "fast"), replace(FAST, epochs=0.1)
    folder = tmp_path_factory.mktemp("short")
    loop.train(packed_file, config, settings, folder)
    return config, settings, folder


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("step", step) for step in ("x", -5, 2.0, None, [1], torch.ones(3), 10**6)),
        ("recent", 1),
        ("recent", ["a"]),
    ],
)
def test_a_checkpoint_of_odd_values_is_told_in_one_line(
    packed_file, short_training, tmp_path, name, value
):
    config, settings, folder = short_training
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    path = tmp_path / loop.CHECKPOINT
    save_atomically(path, {**read_checkpoint(path), name: value})
    with pytest.raises(
        ValueError, match=r"checkpoint.pt is not a checkpoint of this training .*: remove it"
    ) as told:
        loop.train(packed_file, config, settings, tmp_path)
    assert "\n" not in str(told.value)


class Harmful:
    def __reduce__(self):
        return print, ("executed",)


def test_a_training_that_goes_on_executes_nothing_of_its_checkpoint(packed_file, tmp_path, capsys):
    torch.save({"config": Harmful()}, tmp_path / loop.CHECKPOINT)
    with pytest.raises(ValueError, match="is damaged or not a checkpoint"):
        loop.train(packed_file, presets.make_config(AREA, "fast"), FAST, tmp_path)
    assert "executed" not in capsys.readouterr().out


def test_settings_logs_and_curves_are_kept_in_order(tmp_path):
    path = tmp_path / loop.CHECKPOINT
    for step in (1, 2):
        save_atomically(path, {"step": step, "weights": torch.arange(3)})
        state = read_checkpoint(path)
        assert state["step"] == step
        assert state["weights"].tolist() == [0, 1, 2]
    assert list(tmp_path.iterdir()) == [path]
    identity = {"config": {"area": (1.0, 2.0)}, "preset": {"seed": 0}, "start": ""}
    # a run of old, which knew no start
    save_atomically(path, {"config": {"area": (1.0, 2.0)}, "preset": {"seed": 0}})
    read_checkpoint(path, identity=identity)
    with pytest.raises(ValueError, match="another preset and start: choose another folder"):
        read_checkpoint(path, identity={**identity, "preset": {"seed": 1}, "start": "abc"})
    path = tmp_path / "log.csv"
    training_log.cut_log(path, 5)
    for step in (5, 10, 15):
        training_log.add_figures(path, step, step / 10, {"box": 1.0 / step})
    with path.open("a") as file:
        file.write("20,2.0,bo")  # killed in the middle of a line
    training_log.cut_log(path, 10)
    assert training_log.read_curves(path) == {"box": ([0.5, 1.0], [0.2, 0.1])}
    path.write_text("")
    training_log.cut_log(path, 10)
    training_log.add_figures(path, 1, 0.1, {"box": 1.0})
    assert training_log.read_curves(path) == {"box": ([0.1], [1.0])}
    path.unlink()
    training_log.add_figures(path, 1, 0.5, {"residuals": 2.0, "class": 3.0})
    training_log.add_figures(path, 2, 1.0, {"AP@0.7": 0.25, "class": 1.0})
    assert path.read_text().splitlines()[:2] == ["step,epoch,name,value", "1,0.5000,residuals,2.0"]
    found = training_log.read_curves(path)
    assert list(found) == ["residuals", "class", "AP@0.7"]
    assert found["class"] == ([0.5, 1.0], [3.0, 1.0])
