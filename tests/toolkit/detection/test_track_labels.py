"""Tracks next to KITTI's labels: what counts, as another package counts it."""

import numpy as np
import pytest

from toolkit.detection.track_evaluation import evaluate_tracks
from toolkit.detection.track_labels import pair_with_labels

KINDS = ("Car", "Car", "Car", "Van", "Pedestrian", "Person", "Cyclist")
MATRIX = "1 0 0 0 0 1 0 0 0 0 1 0"
FOCAL = "700 0 620 0 0 700 187 0 0 0 1 0"


def row(frame, number, kind, place, *, truncated=0, occluded=0, top=150.0, left=100.0, score=None):
    """A row of a body 15 m ahead and `place` m to the right, whose rectangle ends at 200 px."""
    end = "" if score is None else f" {score}"
    size = "1.6 1.8 4.2" if kind in ("Car", "Van") else "1.7 0.6 0.8"
    image = f"{left} {top} {left + 60} 200"
    place = f"{place:.3f} 1.65 15.0 0.3"
    return f"{frame} {number} {kind} {truncated} {occluded} -1 {image} {size} {place}{end}\n"


def write_pair(folder, seed):
    """Random labels, and tracks that follow most of them and others."""
    rng = np.random.default_rng(seed)
    labels, tracks = [], []
    for frame in range(12):
        labels.append(
            f"{frame} -1 DontCare -1 -1 -10 700 100 900 250 -1 -1 -1 -1000 -1000 -1000 -10\n"
        )
        for number, kind in enumerate(KINDS):
            if rng.random() < 0.2:
                continue
            place = 8.0 * number + 0.3 * frame
            hidden = {"truncated": int(rng.random() < 0.2), "occluded": int(rng.integers(0, 4))}
            labels.append(row(frame, number, kind, place, **hidden))
            if rng.random() < 0.8:
                found = "Pedestrian" if kind == "Person" else kind.replace("Van", "Car")
                name = number + 20 * int(rng.random() < 0.1)
                shifted = place + rng.normal(0, 0.4)
                tracks.append(row(frame, name, found, shifted, score=rng.normal(0, 3)))
        if rng.random() < 0.8:
            left, top = rng.choice([100.0, 720.0]), rng.choice([150.0, 180.0])
            tracks.append(row(frame, 90, "Car", -30.0, left=left, top=top, score=1.0))
    (folder / "labels.txt").write_text("".join(labels))
    (folder / "tracks.txt").write_text("".join(tracks))
    return folder / "labels.txt", folder / "tracks.txt"


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("label", ["vehicle", "pedestrian"])
def test_what_counts_is_what_motrics_counts(tmp_path, limits, seed, label):
    motrics = pytest.importorskip("motrics")
    # motrics compares people by overlap too
    limits("toolkit.tracking.frame_overlap", PEDESTRIAN=-1)
    truth, tracks = write_pair(tmp_path, seed)
    frames = pair_with_labels(truth, tracks).frames
    (found,) = evaluate_tracks(frames, [label]).tracks
    gt, regions = motrics.kitti_3d.load_kitti_3d_gt(truth)
    kind = "car" if label == "vehicle" else label
    predicted = motrics.load_kitti_3d(tracks)
    pairs = motrics.preprocess_kitti_3d(gt, predicted, kind, ignore_regions=regions)
    hota = motrics.compute_hota_from_similarity(*pairs)
    identity = motrics.compute_identity_from_similarity(*pairs)
    scores = found.scores
    assert scores.objects > 0
    assert (scores.hota, scores.deta, scores.assa) == pytest.approx(
        (hota.hota, hota.deta, hota.assa), abs=1e-9
    )
    assert scores.idf1 == pytest.approx(identity.idf1, abs=1e-9)


def test_rectangles_follow_from_a_calibration(tmp_path):
    """A false alarm 150 m ahead is 7 px high, whatever its row says."""
    for folder in ("label_02", "calib", "results"):
        (tmp_path / folder).mkdir()
    labels = tmp_path / "label_02/0000.txt"
    labels.write_text("".join(row(frame, 1, "Car", 0.0) for frame in range(3)))
    far = row(0, 5, "Car", 0.0, score=1.0).replace(" 15.0 ", " 150.0 ")
    tracks = tmp_path / "results/0000.txt"
    tracks.write_text("".join(row(frame, 1, "Car", 0.0, score=1.0) for frame in range(3)) + far)

    def false_alarms():
        frames = pair_with_labels(labels, tracks, rate_hz=10).frames
        return round(3 * (1 - evaluate_tracks(frames).tracks[0].scores.mota))

    assert false_alarms() == 1
    lines = [f"P{k}: {FOCAL}" for k in range(4)]
    lines += ["R_rect 1 0 0 0 1 0 0 0 1", f"Tr_velo_cam {MATRIX}", f"Tr_imu_velo {MATRIX}"]
    (tmp_path / "calib/0000.txt").write_text("\n".join(lines))
    assert false_alarms() == 0


def test_folders_hold_a_text_for_each_sequence(tmp_path):
    for folder in ("labels", "results"):
        (tmp_path / folder).mkdir()
    for name in ("0000", "0001", "0002"):
        text = "".join(row(frame, 1, "Car", 0.0) for frame in range(4))
        (tmp_path / "labels" / f"{name}.txt").write_text(text)
    for name in ("0000", "0001"):
        text = "".join(row(frame, 1, "Car", 0.0, score=1.0) for frame in range(5))
        (tmp_path / "results" / f"{name}.txt").write_text(text)
    paired = pair_with_labels(tmp_path / "labels", tmp_path / "results")
    assert (paired.unscored, paired.late, len(paired.frames)) == (["0002"], 2, 10)
    scores = evaluate_tracks(paired.frames).tracks[0].scores
    assert (scores.objects, scores.switches) == (2, 0)
    (tmp_path / "results/0009.txt").write_text("")
    with pytest.raises(ValueError, match="0009"):
        pair_with_labels(tmp_path / "labels", tmp_path / "results")


def test_tracks_of_another_place_are_refused(tmp_path):
    truth, tracks = write_pair(tmp_path, 0)
    tracks.write_text(row(0, 1, "Car", 500.0, score=1.0))
    with pytest.raises(ValueError, match="comes within 5 m of a true one"):
        pair_with_labels(truth, tracks)
