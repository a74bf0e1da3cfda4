"""Scores of tracks: cases by hand, and equality with TrackEval and motrics on random recordings."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.objects import CYCLIST, Objects
from toolkit.tracking.frame_overlap import FramePairs
from toolkit.tracking.scores import score_pairs, score_tracks
from toolkit.tracking.tracks import Tracks

CAR = [0.0, 0, 0.75, 4.5, 1.9, 1.5, 0.0]


def pairs(truth, tracks, similarity):
    shape = (len(truth), len(tracks))
    return FramePairs(np.array(truth), np.array(tracks), np.array(similarity, float).reshape(shape))


def test_perfect_tracks_score_one():
    found = score_pairs([pairs([4, 9], [0, 1], [[1, 0], [0, 1]])] * 5)
    assert (found.hota, found.deta, found.assa, found.mota, found.idf1) == (1, 1, 1, 1, 1)
    assert (found.switches, found.mostly_tracked, found.objects) == (0, 1, 2)


def test_a_track_that_breaks_in_the_middle_loses_association_alone():
    frames = [pairs([4], [0], [[1]])] * 5 + [pairs([4], [1], [[1]])] * 5
    found = score_pairs(frames)
    assert found.deta == 1
    assert found.assa == pytest.approx(0.5)
    assert found.hota == pytest.approx(np.sqrt(0.5))
    assert found.switches == 1
    assert found.mota == pytest.approx(0.9)
    assert found.idf1 == 0.5


def test_misses_and_ghosts_count():
    frames = [pairs([4, 5], [0], [[1], [0]]), pairs([4, 5], [0, 8], [[1, 0], [0, 0]])]
    found = score_pairs(frames)
    assert found.deta == pytest.approx(2 / 5)
    assert found.mota == pytest.approx(1 - 3 / 4)
    assert found.mostly_tracked == 0.5


def test_without_truth_scores_are_undefined():
    found = score_pairs([pairs([], [0], [])])
    assert np.isnan([found.hota, found.mota, found.idf1]).all()
    assert (found.objects, found.switches) == (0, 0)


def random_frames(seed, frames, objects):
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        truth = np.flatnonzero(rng.random(objects) < 0.8)
        tracks = np.flatnonzero(rng.random(objects + 2) < 0.7)
        similarity = rng.random((len(truth), len(tracks))) ** 3
        similarity[truth[:, None] == tracks] = rng.random() * 0.4 + 0.6
        yield FramePairs(truth, tracks + 100, similarity)


def test_similarities_below_the_threshold_give_no_pair():
    """As TrackEval; motrics 0.3.0 matches the first object in the first frame, and has MOTA 0."""
    frames = [pairs([0, 1], [0, 1], [[0.6, 0.3], [0.9, 0.3]]), pairs([1], [0, 1], [[0.3, 0.9]])]
    found = score_pairs(frames)
    assert found.mota == pytest.approx(-1 / 3)
    assert found.switches == 1


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 12), st.integers(1, 6))
def test_scores_are_those_of_trackeval(seed, frames, objects):
    metrics = pytest.importorskip("trackeval.metrics")
    recording = list(random_frames(seed, frames, objects))
    found = score_pairs(recording)
    if not found.objects:
        return
    truth_ids = np.unique(np.concatenate([frame.truth for frame in recording]))
    track_ids = np.unique(np.concatenate([frame.tracks for frame in recording]))
    data = {
        "num_gt_ids": len(truth_ids),
        "num_tracker_ids": len(track_ids),
        "num_gt_dets": sum(len(frame.truth) for frame in recording),
        "num_tracker_dets": sum(len(frame.tracks) for frame in recording),
        "num_timesteps": len(recording),
        "gt_ids": [np.searchsorted(truth_ids, frame.truth) for frame in recording],
        "tracker_ids": [np.searchsorted(track_ids, frame.tracks) for frame in recording],
        "similarity_scores": [frame.similarity for frame in recording],
    }
    hota = metrics.HOTA().eval_sequence(data)
    clear = metrics.CLEAR().eval_sequence(data)
    assert found.hota == pytest.approx(hota["HOTA"].mean(), abs=1e-9)
    assert found.deta == pytest.approx(hota["DetA"].mean(), abs=1e-9)
    assert found.assa == pytest.approx(hota["AssA"].mean(), abs=1e-9)
    assert found.mota == pytest.approx(clear["MOTA"])
    assert found.switches == clear["IDSW"]
    assert found.mostly_tracked == pytest.approx(clear["MTR"])
    assert found.idf1 == pytest.approx(metrics.Identity().eval_sequence(data)["IDF1"], abs=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 12), st.integers(1, 6))
def test_association_is_that_of_motrics(seed, frames, objects):
    motrics = pytest.importorskip("motrics")
    recording = list(random_frames(seed, frames, objects))
    truth = [frame.truth.tolist() for frame in recording]
    tracks = [frame.tracks.tolist() for frame in recording]
    similarity = [frame.similarity.tolist() for frame in recording]
    if not sum(map(len, truth)):
        return
    found = score_pairs(recording)
    hota = motrics.compute_hota_from_similarity(truth, tracks, similarity)
    assert (found.hota, found.deta, found.assa) == pytest.approx(
        (hota.hota, hota.deta, hota.assa), abs=1e-9
    )
    identity = motrics.compute_identity_from_similarity(truth, tracks, similarity)
    assert found.idf1 == pytest.approx(identity.idf1, abs=1e-9)


def test_boxes_are_compared_by_volume_and_people_by_place():
    boxes = np.array([CAR, [9.0, 0, 0.9, 1.8, 0.6, 1.8, 0.0]])
    truth = Objects(boxes, np.array([0, CYCLIST]), np.array([5, 6]))
    taller = boxes.copy()
    taller[:, 5] *= 2
    found = Tracks(taller, np.ones(2), np.array([0, CYCLIST]))
    assert score_tracks([found], [truth], "cyclist").hota == 1
    assert score_tracks([found], [truth], "vehicle").hota < 0.9
    assert score_tracks([found], [truth], "pedestrian").objects == 0
    with pytest.raises(ValueError, match="got 1 and 0 frames"):
        score_tracks([found], [])
