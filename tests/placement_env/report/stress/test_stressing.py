"""Schemes under stress, on ground with blocks that drive."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.report.stress.stressing import kinds_for, stress
from toolkit.detection.evaluation import evaluate_dataset
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences


def by(rows, **wanted):
    return [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]


@pytest.fixture(scope="module")
def rows(driving, tops):
    both = stress(driving(), tops(), schemes=["early", "foreground"], kinds=("bytes", "silent", "frozen"))
    return both + stress(driving(), tops(), schemes=["foreground"], kinds=("delay", "rate"))


def test_bytes_are_those_of_an_evaluation_after_the_first_second(rows, driving, tops):
    class Later:
        site, sensors = driving.site, driving.sensors

        def __len__(self):
            return 20

        def __getitem__(self, k):
            return replace(driving()[k + 10], index=k + 10)

    found = {(row.scheme, row.codec): row for row in by(rows, kind="bytes")}
    steps = ["2 cm", "4 cm", "8 cm"]
    assert list(found) == [("early", "paper"), *(("early", s) for s in steps), *(("foreground", s) for s in steps)]
    exact = evaluate_dataset(Later(), tops(), schemes=["early"], iou_thresholds=[0.7], noise_seed=None)[0]
    assert found["early", "paper"].judged.ap == pytest.approx(exact.ap, abs=0.02)
    assert found["early", "paper"].kbit_per_sensor == pytest.approx(exact.kbit_per_sensor, rel=0.02)
    early = [found["early", step].kbit_per_sensor for step in steps]
    assert exact.kbit_per_sensor > early[0] > early[1] > early[2]
    kbit = [found["foreground", step].kbit_per_sensor for step in steps]
    assert kbit[0] > kbit[1] > kbit[2] > 0.3
    judged = found["foreground", "2 cm"].judged
    assert 0.5 < judged.low <= judged.ap <= judged.high <= 1
    assert judged.ap > 0.85
    assert (judged.vehicles, judged.frames, judged.kind) == (20, 20, "vehicle")


def test_delay_costs_what_drives_and_tracks_give_it_back(rows):
    late = {row.level: row for row in by(rows, kind="delay")}
    assert late["0.3 s"].judged.ap == 0
    assert late["0.3 s"].age == pytest.approx(0.35, abs=0.06)
    assert late["0.3 s, tracks"].judged.ap > 0.3  # sensors of different ages smear the car, which no track can mend
    assert late["0.3 s, tracks"].kbit_per_sensor == late["0.3 s"].kbit_per_sensor


def test_a_lower_rate_is_as_old_as_it_is_rare(rows):
    rate = by(rows, kind="rate", level="every 5 frames")[0]
    assert rate.age == pytest.approx(0.2, abs=0.01)
    assert rate.judged.ap < by(rows, kind="rate", level="every 5 frames, tracks")[0].judged.ap


def test_differences_show_what_foreground_does_in_fewer_bytes_unless_messages_are_lost(monkeypatch, driving, tops):
    """Where the block stands still; with losses the centre waits for whole images, less so where all refer to these."""
    monkeypatch.setattr("placement_env.report.stress.conditions.LOSSES", ((0.3, None),))

    standing = driving()
    here, away = standing.box(0), np.array([[40.0, 0, 0, 0, 0, 0, 0]])
    monkeypatch.setattr(standing, "box", lambda k: here + (k < 8) * away)
    key = ForegroundDifferences(refers_to="key", name="to key")
    rows = stress(standing, tops(), schemes=["foreground", "differences", key], kinds=("bytes", "loss"))
    found = {(row.kind, row.level, row.scheme): row for row in rows if row.codec == "2 cm"}
    nothing = "nothing goes wrong"
    whole, previous, to_key = (found["bytes", nothing, name] for name in ("foreground", "differences", "to key"))
    assert previous.judged.ap == to_key.judged.ap == whole.judged.ap
    assert previous.kbit_per_sensor < 0.95 * whole.kbit_per_sensor
    assert to_key.kbit_per_sensor < 0.95 * whole.kbit_per_sensor
    lossy = [found["loss", "30%", name] for name in ("foreground", "differences", "to key")]
    ages = [row.age for row in lossy]
    assert 0 < ages[0] <= ages[2] < ages[1]
    assert lossy[1].kbit_per_sensor == pytest.approx(previous.kbit_per_sensor)
    assert lossy[2].kbit_per_sensor == pytest.approx(to_key.kbit_per_sensor)
    assert {row.codec for row in rows if row.kind == "bytes"} == {"2 cm", "4 cm", "8 cm"}


def test_one_silent_sensor_leaves_the_other_and_a_frozen_one_shows_ghosts(rows):
    assert [row.level for row in by(rows, kind="silent", scheme="early")] == ["a", "b"]
    assert all(row.judged.ap > 0.5 for row in by(rows, kind="silent"))
    assert all(row.judged.ap < 0.5 for row in by(rows, kind="frozen", scheme="early"))


def test_what_a_recording_can_show(driving):
    assert "delay" in kinds_for(driving())
    assert kinds_for(driving(apart=5.0)) == ("bytes", "pose", "mounting", "silent", "pairs", "blinded", "frozen")
    assert kinds_for(driving(), ["loss"]) == ("loss",)
    with pytest.raises(ValueError, match=r"'delay' needs frames at most 0\.5 s apart, these are 5 s"):
        kinds_for(driving(apart=5.0), ["delay"])
    with pytest.raises(ValueError, match="choose among bytes"):
        kinds_for(driving(), ["storm"])


def test_pose_errors_and_blinded_sensors_far_apart_and_progress(driving, tops):
    done = []
    rows = stress(
        driving(4, 5.0), tops(), schemes=[Foreground()], kinds=["pose", "blinded"], frames=3,
        progress=lambda *counts: done.append(counts),
    )  # fmt: skip
    assert [row.level for row in rows[:6]] == [f"{x} m, {x}°" for x in ("0", "0.1", "0.2", "0.4", "0.6", "1")]
    assert [row.level for row in rows[6:]] == ["a", "b"]
    assert [row.amount for row in rows] == [0, 0.1, 0.2, 0.4, 0.6, 1, None, None]
    assert done[0] == (1, 24)
    assert done[-1] == (24, 24)
    assert {row.judged.frames for row in rows} == {3}
    assert len({row.judged.ap for row in rows[:3]} | {row.kbit_per_sensor for row in rows}) > 2


def test_nonsense_is_refused(driving, tops):
    for wrong, said in (
        ({"schemes": []}, "a scheme to stress"),
        ({"ious": ()}, "and an IoU"),
        ({"frames": 0}, "a frame to stress"),
        ({"label": "ox"}, "ox"),
    ):
        with pytest.raises(ValueError, match=said):
            stress(driving(), tops(), kinds=["bytes"], **wrong)
