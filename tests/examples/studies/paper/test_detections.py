"""Detections of every run, and their AP."""

import json
import sqlite3
from dataclasses import dataclass, replace

import numpy as np
import pytest

from examples.studies.paper import detections
from placement_env.fidelity.detector import IGNORED, IOUS, Detected
from placement_env.subsets import all_subsets
from toolkit.boxes import count_points, iou_3d
from toolkit.detection.metrics import average_precision, evaluate, precision_recall
from toolkit.objects import HEAVY, VEHICLE, Detections, Objects
from toolkit.points import has_centre_inside
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Processes
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

PLACES = np.array([-20.0, -10, 0, 10, 20, 43.0])  # the last one is outside the area
RUNS = [
    *(detections.SchemeRun(scheme, (0, 1, 2)) for scheme in ("early", "late")),
    *(detections.SchemeRun("hybrid", (0, 2)), detections.SchemeRun("early", (1,))),
]


def cars(x):
    one = np.ones_like(x)
    return np.column_stack([x, 0 * x, 0.75 * one, 4 * one, 2 * one, 1.5 * one, 0 * x])


@dataclass
class Street:
    """Cars, one of them heavy, near the places; each of three sensors has points on some; frame 2
    is empty."""

    frames: int = 5
    site = Site("street", np.array([-40.0, -20.0, 40.0, 20.0]), hybrid_radius=12.0)
    sensors = tuple(Sensor(f"s{c}", DepthCamera(), np.eye(4)) for c in range(3))
    digest: str = "street"

    def clouds(self, k, c):
        rng = np.random.default_rng([k, c])
        return np.column_stack(
            [rng.uniform(-25, 25, 60), rng.uniform(-1, 1, 60), rng.uniform(0, 1, 60)]
        ).astype("f4")

    def objects(self, k):
        if k == 2:
            return Objects.empty()
        labels = np.array([VEHICLE] * 4 + [HEAVY, VEHICLE])
        return Objects(cars(PLACES + np.random.default_rng(k).uniform(-0.6, 0.6, 6)), labels)


class Guess:
    """A car at each place with points; it fails at one of its calls."""

    digest = "guess"

    def __init__(self, fails=-1):
        self.calls, self.fails = 0, fails

    def __call__(self, points):
        self.calls += 1
        if self.calls == self.fails:
            raise KeyboardInterrupt
        counts = count_points(points, cars(PLACES))
        return Detections(cars(PLACES), counts / 50.0)[counts > 2]


def same(a, b):
    assert a.runs.keys() == b.runs.keys()
    for run in a.runs:
        for mine, theirs in zip(a.runs[run], b.runs[run], strict=True):
            named = zip(mine._asdict().items(), theirs, strict=True)
            assert all(np.array_equal(x, y) for (name, x), y in named if name != "ms"), run
    for mine, theirs in zip(a.truths, b.truths, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(mine, theirs, strict=True))


@pytest.fixture(scope="module")
def whole():
    return detections.detect_runs(Street(), Guess(), RUNS, memo=Cache(), frames=5)


def test_figures_are_those_of_the_detector(whole):
    street = Street()
    for run in RUNS:
        theirs = Detected(street, Guess(), run.scheme)
        for iou, estimate in theirs.estimates(np.isin(np.arange(3), run.sensors)[None]).items():
            ours = detections.score_run(whole, run, iou)
            assert (ours.ap, ours.recall) == pytest.approx((estimate.ap[0], estimate.recall[0]))
            kbit = np.mean([found.bits.sum() for found in whole.runs[run]]) / 1000
            assert kbit == pytest.approx(estimate.kbit[0])
    assert len(all_subsets(3)) == 8


def test_published_ap_is_that_of_the_published_protocol(whole):
    street, run = Street(), RUNS[0]
    truths = [street.objects(k) for k in range(5)]
    there = [truth[has_centre_inside(truth.boxes, street.site.area)] for truth in truths]
    found = [Detections(each.boxes, each.scores) for each in whole.runs[run]]
    for iou, at in evaluate(found, there, iou_thresholds=(0.7, 0.8), protocol="published").items():
        assert detections.compute_published_ap(whole, run, iou) == pytest.approx(at.ap)


def test_truths_have_their_points_and_what_is_sent(whole):
    street = Street()
    assert whole.to_find == (4, 4, 0, 4, 4)
    assert whole.vehicles == 16
    boxes = street.objects(3).boxes[:4]
    assert whole.truths[3].boxes.tolist() == boxes.tolist()
    for c in range(3):
        assert (
            whole.truths[3].points[:, c].tolist()
            == count_points(street.clouds(3, c), boxes).tolist()
        )
    both = np.concatenate([truth.points[:, [0, 2]].sum(axis=1) for truth in whole.truths])
    assert whole.points((0, 2)).tolist() == both.tolist()
    far = np.abs(np.linalg.norm(street.clouds(0, 1)[:, :2], axis=1)) > 12.0
    assert whole.truths[0].sent[:2, 1].tolist() == [60, far.sum()]


def test_the_best_iou_is_that_with_any_detection(whole):
    for k, found in enumerate(whole.runs[RUNS[1]]):
        truth = Street().objects(k).boxes[:4] if k != 2 else np.zeros((0, 7))
        assert found.best == pytest.approx(iou_3d(found.boxes, truth).max(axis=0, initial=0.0))


def test_killed_and_started_again_it_goes_on(tmp_path, whole):
    once = Guess()
    detections.detect_runs(Street(), once, RUNS, memo=Cache(), frames=5)
    killed, rest = Guess(fails=9), Guess()
    with pytest.raises(KeyboardInterrupt):
        detections.detect_runs(Street(), killed, RUNS, memo=Cache(tmp_path / "memo"), frames=5)
    counts = []
    done = detections.detect_runs(
        Street(),
        rest,
        RUNS,
        memo=Cache(tmp_path / "memo"),
        frames=5,
        processes=Processes(progress=lambda *each: counts.append(each)),
    )
    same(done, whole)
    assert rest.calls < once.calls
    assert killed.calls + rest.calls <= once.calls + 6  # of the frame that was cut short
    assert counts[-1][1:] == (len(counts), len(counts))
    assert 1 < len(counts) < 5


def test_all_that_is_kept_is_not_detected_again(tmp_path, whole):
    memo = tmp_path / "memo"
    detections.detect_runs(Street(), Guess(), RUNS, memo=Cache(memo), frames=5)
    never = Guess(fails=1)
    same(
        detections.detect_runs(
            Street(),
            never,
            RUNS,
            memo=Cache(memo),
            frames=5,
            processes=Processes(progress=lambda *_: 1 / 0),
        ),
        whole,
    )
    assert never.calls == 0
    fewer = detections.detect_runs(Street(), never, RUNS[:1], memo=Cache(memo), frames=2)
    assert (fewer.frames, list(fewer.runs)) == (2, RUNS[:1])


def test_runs_cost_themselves_alone_and_others_share_nothing(tmp_path):
    memo, more = tmp_path / "memo", Guess()
    detections.detect_runs(Street(), Guess(), RUNS[:1], memo=Cache(memo), frames=3)
    detections.detect_runs(Street(), more, [RUNS[0], RUNS[3]], memo=Cache(memo), frames=3)
    assert more.calls == 3
    memo = tmp_path / "memo"
    detections.detect_runs(Street(), Guess(), RUNS[3:], memo=Cache(memo), frames=2)
    other = Guess()
    other.digest = "other"
    detections.detect_runs(Street(), other, RUNS[3:], memo=Cache(memo), frames=2)
    elsewhere = Guess()
    detections.detect_runs(
        Street(digest="elsewhere"), elsewhere, RUNS[3:], memo=Cache(memo), frames=2
    )
    assert (other.calls, elsewhere.calls) == (2, 2)
    with pytest.raises(ValueError, match="has none: add one"):
        detections.detect_runs(
            Street(), lambda points: Detections.empty(), RUNS, memo=Cache(), frames=1
        )


def test_damaged_memos_and_processes_change_nothing(tmp_path, whole):
    memo = tmp_path / "memo"
    kept = Cache(memo)
    detections.detect_runs(Street(), Guess(), RUNS, memo=kept, frames=5)
    kept.close()
    memo.write_bytes(b"no database at all, but long enough to be read as one" * 40)
    with pytest.warns(UserWarning, match="damaged"):
        again = detections.detect_runs(Street(), Guess(), RUNS, memo=Cache(memo), frames=5)
    same(again, whole)
    same(
        detections.detect_runs(
            Street(),
            Guess(),
            RUNS,
            memo=Cache(tmp_path / "memo"),
            frames=5,
            processes=Processes(workers=2),
        ),
        whole,
    )
    assert json.dumps(whole.to_find) == "[4, 4, 0, 4, 4]"


def test_a_flipped_byte_costs_one_frame(tmp_path, whole):
    memo = Cache(tmp_path / "memo")
    detections.detect_runs(Street(), Guess(), RUNS, memo=memo, frames=5)
    with sqlite3.connect(tmp_path / "memo") as database:
        key, value = database.execute("SELECT key, value FROM entries LIMIT 1").fetchone()
        damaged = value[:-1] + bytes([value[-1] ^ 1])
        database.execute("UPDATE entries SET value = ? WHERE key = ?", (damaged, key))
    counts = []
    same(
        detections.detect_runs(
            Street(),
            Guess(),
            RUNS,
            memo=memo,
            frames=5,
            processes=Processes(progress=lambda *each: counts.append(each)),
        ),
        whole,
    )
    assert counts == [("frames detected", 1, 1)]


@pytest.mark.parametrize("frames", [0, 6])
def test_refuses_frames(frames):
    with pytest.raises(ValueError, match=f"frames must be from 1 to the 5 recorded, got {frames}"):
        detections.detect_runs(Street(), Guess(), RUNS, memo=Cache(), frames=frames)


ALL = detections.SchemeRun("early", (0, 1, 2, 3, 4, 5))


def by_hand(stored, run, iou, region):
    """Object by object: score, and whether it is a hit, of all that counts; and how many there are
    to find."""
    scores, hits, to_find = [], [], 0
    sensors = [stored.sensors[c] for c in region]
    for truth, found in zip(stored.truths, stored.runs[run], strict=True):
        there = [bool(detections.in_view_of_all(sensors, box[None])[0]) for box in truth.boxes]
        to_find += sum(there)
        for box, score, what in zip(
            found.boxes, found.scores, found.truth[IOUS.index(iou)], strict=True
        ):
            counts = (
                there[what]
                if what >= 0
                else what != IGNORED and detections.in_view_of_all(sensors, box[None])[0]
            )
            if counts:
                scores.append(score)
                hits.append(what >= 0)
    return np.array(scores), np.array(hits, bool), to_find


@pytest.mark.parametrize("region", [(), (1, 5), (2,)])
@pytest.mark.parametrize("iou", IOUS)
def test_score_is_that_of_each_object_by_hand(stored, region, iou):
    scores, hits, to_find = by_hand(stored, ALL, iou, region)
    ours = detections.score_run(stored, ALL, iou, region)
    assert ours.vehicles == to_find
    assert ours.ap == pytest.approx(average_precision(precision_recall(scores, hits, to_find)))
    assert ours.recall == pytest.approx(hits.sum() / to_find)
    assert np.array_equal(ours.tally.scores, scores)
    assert np.array_equal(ours.tally.hit, hits)
    assert ours.interval.low <= ours.ap <= ours.interval.high


def test_pinned_figures_of_regions(stored):
    ours, one = (
        detections.score_run(stored, ALL),
        detections.score_run(stored, detections.SchemeRun("early", (4,))),
    )
    assert (ours.ap, ours.recall, ours.hit_iou) == pytest.approx(
        (0.942694, 1.0, 0.875427), abs=1e-6
    )
    assert (one.ap, one.recall, *one.interval) == pytest.approx(
        (0.324744, 0.446809, 0.199134, 0.472934), abs=1e-6
    )
    assert detections.compute_published_ap(stored, ALL) == pytest.approx(0.949172, abs=1e-6)
    assert detections.score_run(stored, ALL, 0.9).ap == pytest.approx(0.187133, abs=1e-6)
    near, side, behind = np.zeros((3, 7))
    position, forward = stored.sensors[1].position, stored.sensors[1].world_SE3_body[:2, 0]
    near[:2] = position[:2] + 15 * forward
    behind[:2] = position[:2] - 15 * forward
    side[:2] = position[:2] + 15 * np.array([-forward[1], forward[0]])
    boxes = np.stack([near, side, behind])
    assert detections.in_view_of_all([stored.sensors[1]], boxes).tolist() == [True, False, False]
    assert detections.in_view_of_all([], boxes).tolist() == [True] * 3
    assert not detections.in_view_of_all([stored.sensors[1], stored.sensors[0]], boxes)[2]


def test_ignored_detections_and_frames_without_vehicles(stored):
    def without(found):
        keep = found.truth[0] != IGNORED
        return found._replace(
            boxes=found.boxes[keep],
            scores=found.scores[keep],
            truth=found.truth[:, keep],
            published=found.published[:, keep],
        )

    fewer = replace(stored, runs={ALL: tuple(map(without, stored.runs[ALL]))})
    assert detections.score_run(fewer, ALL)[:5] == detections.score_run(stored, ALL)[:5]
    empty = next(k for k, count in enumerate(stored.to_find) if not count)
    found = stored.runs[ALL][empty]
    alarm = found._replace(
        boxes=np.zeros((1, 7)),
        scores=np.ones(1),
        truth=np.full((3, 1), -1),
        published=np.full((3, 1), -1),
    )
    runs = (*stored.runs[ALL][:empty], alarm, *stored.runs[ALL][empty + 1 :])
    worse = replace(stored, runs={ALL: runs})
    assert detections.score_run(worse, ALL).ap < detections.score_run(stored, ALL).ap
    assert detections.compute_published_ap(worse, ALL) == detections.compute_published_ap(
        stored, ALL
    )


def test_costs_shares_and_curves_also_without_vehicles(stored):
    frames = stored.runs[ALL]
    assert detections.kbit_per_sensor(stored, ALL) == pytest.approx(
        np.mean([f.bits for f in frames]) / 1000
    )
    assert detections.ms_per_frame(stored, ALL) == pytest.approx(np.median([f.ms for f in frames]))
    points = np.concatenate([truth.points for truth in stored.truths])
    assert detections.visible_share(stored, (4,)) == pytest.approx((points[:, 4] > 0).mean())
    assert detections.visible_share(stored, (3, 4)) == pytest.approx(
        (points[:, [3, 4]] > 0).any(axis=1).mean()
    )
    there = detections.in_view_of_all(
        [stored.sensors[4]], np.concatenate([truth.boxes for truth in stored.truths])
    )
    assert detections.visible_share(stored, (4,), (4,)) == pytest.approx(
        (points[there, 4] > 0).mean()
    )
    curve = detections.score_run(stored, ALL).curve
    assert curve.recall[-1] == pytest.approx(detections.score_run(stored, ALL).recall)
    empty = next(k for k, count in enumerate(stored.to_find) if not count)
    runs = {ALL: (stored.runs[ALL][empty],)}
    nothing = detections.StoredDetections(
        stored.site, stored.sensors, (stored.truths[empty],), runs, "", ""
    )
    ours = detections.score_run(nothing, ALL)
    assert np.isnan(
        [
            ours.ap,
            ours.recall,
            *ours.interval,
            ours.hit_iou,
            detections.compute_published_ap(nothing, ALL),
        ]
    ).all()
    assert np.isnan(detections.visible_share(nothing, (0,)))
