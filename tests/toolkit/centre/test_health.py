"""Lines of health: one every few seconds, each whole."""

import json
from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration.place import Stand
from toolkit.centre.health import HealthLog, read_memory_mb
from toolkit.centre.running_centre import CentreFrame, LeftOut
from toolkit.centre.sensor_monitor import Fault
from toolkit.centre.sensor_watch import FaultEvent
from toolkit.detection.detect import FrameDetections
from toolkit.frame import Frame
from toolkit.objects import Detections, Objects
from toolkit.tracking.tracks import Tracks

FRAME = Frame((), (), Objects.empty())
NOTHING = LeftOut(0, {}, {})


def frame(ms):
    return CentreFrame(
        FRAME, Detections.empty(), Tracks.empty(), {}, {"detect": ms / 2}, latency_ms=ms
    )


def test_a_line_every_ten_seconds_with_the_times_since_the_line_before(tmp_path):
    path = tmp_path / "logs" / "health.jsonl"
    log = HealthLog(path, 10.0)
    for k in range(250):
        log.add(frame(50.0 if k < 150 else 90.0))
        log.write_line(100.0 + 0.1 * k, {"a": Fault.LATE}, LeftOut(k, {"a": 1}, {"b": 2}))
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["time_s"] for line in lines] == pytest.approx([110.0, 120.0])
    assert [line["frames"] for line in lines] == [101, 201]
    assert lines[0]["ms"]["latency"] == {"median": 50.0, "p95": 50.0, "p99": 50.0}
    assert lines[1]["ms"]["detect"]["p99"] == 45.0
    assert lines[1]["faults"] == {"a": "late"}
    assert lines[1]["dropped_frames"] == 200
    assert (lines[1]["dropped_messages"], lines[1]["late_messages"]) == ({"a": 1}, {"b": 2})
    log.write_line(125.0, {}, NOTHING, is_last=True)
    log.close()
    assert len(path.read_text().splitlines()) == 3


def test_the_summary_is_of_the_whole_run_and_counts_faults():
    log = HealthLog(None)
    for ms in np.arange(100.0):
        log.add(frame(ms))
    for fault in (Fault.SILENT, None, Fault.SILENT):
        log.add_event(FaultEvent(1.0, "a", fault))
    log.write_line(1.0, {}, NOTHING)
    summary = log.summarise()
    assert summary["frames"] == 100
    assert summary["faults"] == {"a silent": 2}
    assert log.times.summarise()["latency"]["median"] == 49.5
    log.close()


def test_times_of_late_detections_count_with_the_others():
    log = HealthLog(None)
    stand = Stand(np.array([-1.0, -1.0, 1.0, 1.0]), np.zeros(2))
    late = FrameDetections(FRAME, Detections.empty(), stand, detect_ms=95.0)
    log.add(replace(frame(80.0), detection_age_s=0.1, late_detections=(late,)))
    log.add(replace(frame(80.0), detection_age_s=0.0))
    times = log.times.summarise()
    assert times["detect"]["median"] == 40.0
    assert times["detect"]["p99"] > 90.0
    assert times["detection_age"]["median"] == 50.0
    assert LeftOut(1, {}, {}, predicted=3, late_detections=2).as_dict()["late_detections"] == 2
    log.close()


def test_memory_is_this_process():
    before = read_memory_mb()
    block = np.ones(20_000_000)
    assert read_memory_mb() > before + 100
    assert len(block)
    with pytest.raises(ValueError, match="more than 0 s"):
        HealthLog(None, 0.0)
