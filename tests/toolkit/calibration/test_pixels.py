"""Empty scenes beside a slow oracle that takes one pixel after the other."""

import math
from itertools import pairwise, product

import numpy as np
import pytest

from toolkit.calibration import empty_scene
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SolidStateLidar
from toolkit.sensors.sensor import Sensor

MODEL = SolidStateLidar(rows=6, columns=8)
CAMERA = DepthCamera(width=16, height=12, stride=2)  # as many pixels


def deviation(value, model=MODEL):
    return float(np.ravel(model.deviation(np.array([value], np.float32)))[0]) if math.isfinite(value) else 0.0


def images(n, seed, model=MODEL):
    """Pixels that see up to four surfaces, some of them in runs, each with noise, and pixels that see a new one each
    time."""
    rng = np.random.default_rng(seed)
    made = np.zeros((n, *model.shape), np.float32)
    for row, column in np.ndindex(model.shape):
        kind = rng.integers(5)
        if kind == 0:
            depth = rng.uniform(3, 60, n)
        else:
            surfaces = rng.choice([0.0, 8.0, 8.4, 20.0, 21.0, 50.0], rng.integers(1, 5), replace=False)
            which = rng.integers(len(surfaces), size=n)
            depth = surfaces[np.sort(which) if kind == 1 else which]
            depth = depth + rng.normal(0, 0.02, n) * (depth > 0)
        made[:, row, column] = depth
    return made


def clusters_of(values, model):
    """Sorted measurements of one pixel in clusters, the last of which may be nothing returned."""
    parts = [[values[0]]]
    for before, value in pairwise(values):
        gap = max(4 * deviation(before, model), 0.004 * before)
        if (math.isinf(value) and math.isfinite(before)) or (math.isfinite(value) and value - before > gap):
            parts.append([])
        parts[-1].append(value)
    return parts


def mode_of(part, n, model):
    """Median, spread, share, least and greatest of one cluster."""
    finite = [value if math.isfinite(value) else 0.0 for value in part]
    median = float(np.median(finite))
    spread = max(1.4826 * float(np.median(np.abs(np.array(finite) - median))), deviation(median, model))
    return [median, spread if median > 0 else 0.0, len(part) / n, finite[0], finite[-1]]


def pixel_modes(series, model):
    """Farthest cluster of the scene, the largest nearer one, and whether that flickers."""
    n = len(series)
    times = [value if 0 < value < model.max_range else math.inf for value in series.tolist()]
    parts = clusters_of(sorted(times), model)
    least = min(n, max(2, math.ceil(0.1 * n)))
    enough = [k for k, part in enumerate(parts) if len(part) >= least]
    far = enough[-1] if enough else max(range(len(parts)), key=lambda k: (len(parts[k]), k))
    rivals = [k for k in enough if k < far and math.isfinite(parts[k][0])]
    none = [math.nan, 0.0, 0.0, 0.0, 0.0]
    if not rivals:
        return mode_of(parts[far], n, model), none, False
    near = parts[max(rivals, key=lambda k: (len(parts[k]), k))]
    present = [near[0] <= value <= near[-1] for value in times]
    share = sum(present) / n
    comes = sum(now and not before for before, now in zip([False, *present[:-1]], present, strict=True))
    return mode_of(parts[far], n, model), mode_of(near, n, model), comes >= 0.25 * share * (1 - share) * n


@pytest.mark.parametrize(("n", "model"), [(1, MODEL), (2, MODEL), (3, CAMERA), (13, CAMERA), (20, MODEL), (41, MODEL)])
def test_clusters_of_every_pixel_are_an_oracles(n, model):
    stack = images(n, n, model)
    far, near, flickers = empty_scene._clusters(stack, model)
    for at in np.ndindex(model.shape):
        wanted_far, wanted_near, wanted = pixel_modes(stack[(slice(None), *at)], model)
        assert [each[at] for each in far] == pytest.approx(wanted_far, rel=1e-4, abs=1e-5), at
        assert [each[at] for each in near] == pytest.approx(wanted_near, rel=1e-4, abs=1e-5, nan_ok=True), at
        assert flickers[at] == wanted, at


def random_mode(seed, shape=MODEL.shape):
    rng = np.random.default_rng(seed)
    median = np.where(rng.random(shape) < 0.2, 0, rng.uniform(5, 60, shape)).astype(np.float32)
    spread = np.where(median > 0, rng.uniform(0.01, 0.2, shape), 0).astype(np.float32)
    share = rng.choice([0.3, 0.5, 0.9], shape).astype(np.float32)
    return empty_scene._Mode(median, spread, share, median - 1, median + 1)


def test_the_usual_spread_is_the_median_of_pixels_as_far_that_mostly_see_the_scene():
    far = random_mode(3, (20, 30))
    clear = [
        (math.log(m), s)
        for m, s, share in zip(*(e.ravel().tolist() for e in far[:3]), strict=True)
        if m and share >= 0.5
    ]
    low, high = min(clear)[0], max(clear)[0] + 1e-6
    steps: dict[int, list[tuple[float, float]]] = {}
    for distance, spread in clear:
        steps.setdefault(int((distance - low) / (high - low) * 24), []).append((distance, spread))
    middles = [np.median([d for d, _ in steps[k]]) for k in sorted(steps)]
    usual = [np.median([s for _, s in steps[k]]) for k in sorted(steps)]
    asked = np.array([[0.0, 5.5, 20.0, 59.0, 200.0, np.nan]], np.float32)
    logs = [math.log(each) if each > 0 else 0.0 for each in asked[0]]
    wanted = [
        max(np.interp(at, middles, usual), deviation(d)) for at, d in zip(logs, np.nan_to_num(asked[0]), strict=True)
    ]
    found = empty_scene._usual_spread(far, MODEL)(asked)
    assert found[0] == pytest.approx(wanted, rel=1e-5)
    nothing = far._replace(share=np.zeros_like(far.share))
    assert empty_scene._usual_spread(nothing, MODEL)(asked)[0] == pytest.approx(
        [deviation(d) for d in np.nan_to_num(asked[0])]
    )
    sky = empty_scene._Mode(*(np.zeros((2, 2), np.float32) for _ in range(5)))
    sky = sky._replace(share=np.ones((2, 2), np.float32))
    assert empty_scene._usual_spread(sky, MODEL)(np.full((1, 1), 9.0, np.float32)).item() == pytest.approx(
        deviation(9.0)
    )


def narrowed(values, least, greatest, usual):
    """Densest stretch of a pixel's measurements, the farthest of equal ones."""
    inside = sorted(value for value in values if least <= value <= greatest)
    counts = [sum(start <= value <= start + 8 * usual for value in inside[k:]) for k, start in enumerate(inside)]
    begin = max(range(len(inside)), key=lambda k: (counts[k], k))
    part = inside[begin : begin + counts[begin]]
    median = float(np.median(part))
    off = sorted(abs(value - median) for value in part)[(len(part) - 1) // 2]
    return median, min(max(1.4826 * off, usual), 2 * usual), len(part) / len(values)


@pytest.mark.parametrize("at_once", [256, 7])
def test_broad_clusters_are_narrowed_as_an_oracle_does(monkeypatch, at_once):
    monkeypatch.setattr(empty_scene, "_AT_ONCE", at_once)
    rng = np.random.default_rng(5)
    stack = rng.choice(np.linspace(9.0, 12.0, 61), (23, *MODEL.shape)).astype(np.float32)
    stack[:, rng.random(MODEL.shape) < 0.5] *= 1.5
    usual = rng.uniform(0.011, 0.05, MODEL.shape).astype(np.float32)
    least = np.sort(stack, axis=0)[3]
    mode = empty_scene._Mode(
        np.median(stack, axis=0), usual * rng.choice([1.0, 1.9, 2.1, 9.0], MODEL.shape).astype(np.float32),
        np.ones(MODEL.shape, np.float32), least, np.sort(stack, axis=0)[-2],
    )  # fmt: skip
    before = [each.copy() for each in mode]
    found = empty_scene._narrow_broad(mode, usual, list(stack))
    for at in np.ndindex(MODEL.shape):
        if mode.spread[at] <= 2 * usual[at]:
            assert [each[at] for each in found] == [each[at] for each in mode]
            continue
        values, (low, high) = stack[(slice(None), *at)].tolist(), (mode.least[at], mode.greatest[at])
        wanted = narrowed(values, low, high, float(usual[at]))
        assert (found.median[at], found.spread[at], found.share[at]) == pytest.approx(wanted, rel=1e-4), at
    assert all(np.array_equal(one, other) for one, other in zip(mode, before, strict=True))


def continues(near, far, row, column):
    """Whether a neighbour's farthest surface goes on in a nearer one, and is another than the pixel's own plane."""
    median = float(near.median[row, column])
    within = max(4 * float(near.spread[row, column]), 0.004 * median)

    def inverse(i, j):
        depth = float(far[min(max(i, 0), far.shape[0] - 1), min(max(j, 0), far.shape[1] - 1)])
        return 1 / depth if depth > 0 else 0.0

    for down, right in product(range(-2, 3), repeat=2):
        i, j = row + down, column + right
        if not (0 <= i < far.shape[0] and 0 <= j < far.shape[1]):
            continue
        there = float(far[i, j])
        plane = (2 * inverse(row, column) - inverse(row - down, column - right)) * there
        if abs(there - median) <= within and abs(plane - 1) > 0.1:
            return True
    return False


@pytest.mark.parametrize("seed", range(3))
def test_nearer_surfaces_that_continue_a_neighbours_are_an_oracles(seed):
    rng = np.random.default_rng(seed)
    far = rng.choice([0.0, 0.5, 10.0, 10.5, 12.0, 30.0], MODEL.shape).astype(np.float32)
    median = np.where(rng.random(MODEL.shape) < 0.2, np.nan, rng.choice([10.0, 10.03, 11.95, 5.0, 0.5], MODEL.shape))
    spread = rng.choice([0.001, 0.02], MODEL.shape).astype(np.float32)
    near = empty_scene._Mode(median.astype(np.float32), spread, *(np.zeros(MODEL.shape, np.float32),) * 3)
    found = empty_scene._continuation_mask(near, far)
    wanted = [[continues(near, far, i, j) for j in range(MODEL.shape[1])] for i in range(MODEL.shape[0])]
    assert found.tolist() == wanted
    assert 0 < found.sum() < found.size


@pytest.mark.parametrize(("depth", "elsewhere", "another"), [(0.5, 0.5, False), (1.0, 0.0, True), (10.0, 0.0, True)])
def test_surfaces_within_a_metre_and_beside_nothing_returned(depth, elsewhere, another):
    """A plane goes on as itself however near it is; where nothing returns there is no plane to go on."""
    far = np.full(MODEL.shape, elsewhere, np.float32)
    far[2, 2] = depth
    spread, none = np.full(MODEL.shape, 0.001, np.float32), np.zeros(MODEL.shape, np.float32)
    found = empty_scene._continuation_mask(
        empty_scene._Mode(np.full(MODEL.shape, depth, np.float32), spread, none, none, none), far
    )
    assert found[2, 3] == continues(empty_scene._Mode(np.full(MODEL.shape, depth), spread, none, none, none), far, 2, 3)
    assert found[2, 3] == another


def test_blocks_of_rows_and_pixels_are_learnt_alike(monkeypatch):
    """However few measurements are sorted at once."""

    def learnt():
        learner = empty_scene.SceneLearner(Sensor("s", MODEL, np.eye(4)))
        for image in images(20, 5):
            learner.add(image)
        return learner.scene()

    whole = learnt()
    assert np.isfinite(whole.second).any()
    clusters, heights = empty_scene._clusters, []

    def noted(stack, model):
        heights.append(stack.shape[1])
        return clusters(stack, model)

    monkeypatch.setattr(empty_scene, "_clusters", noted)
    for block, wanted in ((1, [1] * 6), (400, [2] * 3), (639, [3] * 2), (640, [4, 2]), (960, [6])):
        monkeypatch.setattr(empty_scene, "_BLOCK", block)
        assert learnt().digest == whole.digest
        assert heights == wanted  # rows of 8 columns in 20 images, as many as fit
        heights.clear()


class Pixel:
    """One pixel of a scene that adapts, by the rules that `SceneAdaptation` states."""

    def __init__(self, first, spread, second, second_spread, *, model, seconds, settle, reveal):
        self.modes = [[first, spread], [second, second_spread]]
        self.model, self.seconds, self.settle, self.reveal = model, seconds, settle, reveal
        self.candidate, self.since, self.time = None, 0.0, None

    def update(self, value, time):
        share = 0.0 if self.time is None else 1 - math.exp(-(time - self.time) / self.seconds)
        self.time, shown = time, False
        seen = value if 0 < value < self.model.max_range else math.inf
        for mode in self.modes:
            median, spread = mode
            if math.isinf(seen):
                shown |= median == 0
            elif median > 0 and abs(seen - median) <= 4 * spread:
                off = seen - median
                mode[0] = median + share * off
                mode[1] = max(math.sqrt((1 - share) * spread**2 + share * off**2), deviation(mode[0], self.model))
                shown = True
        first, spread = self.modes[0]
        if self.candidate is not None:
            finite = self.candidate if math.isfinite(self.candidate) else 0.0
            within = 4 * max(spread, deviation(finite, self.model))
            same = seen == self.candidate or abs(seen - self.candidate) <= within
            if not (same or (seen < self.candidate - within and not shown)):
                self.candidate = None
        else:
            same = False
        if self.candidate is None:
            if not shown:
                self.candidate, self.since = seen, time
            return
        farther = self.candidate > (first if first > 0 else math.inf)
        if same and time - self.since >= (self.reveal if farther else self.settle):
            gone = math.isinf(self.candidate)
            depth = 0.0 if gone else self.candidate
            self.modes = [[depth, 0.0 if gone else deviation(depth, self.model)], [math.nan, 0.0]]
            self.candidate = None


@pytest.mark.parametrize(("seed", "model"), [(0, MODEL), (1, CAMERA), (2, MODEL), (3, MODEL)])
def test_every_pixel_adapts_as_the_rules_say(seed, model):
    rng, shape = np.random.default_rng(seed), model.shape
    surfaces = np.array([0.0, 8.0, 20.0, 50.0])
    first = rng.choice(surfaces, shape).astype(np.float32)
    second = np.where(rng.random(shape) < 0.5, np.nan, rng.choice([0.0, 12.0], shape)).astype(np.float32)
    spread = np.where(first > 0, 0.05, 0).astype(np.float32)
    second_spread = np.where(second > 0, 0.05, 0).astype(np.float32)
    share = np.full(shape, 0.7, np.float32)
    given = empty_scene.EmptyScene("s", model, first, spread, share, second, second_spread, 1 - share, 5)
    times = {"seconds": 30.0, "settle": 100.0, "reveal": 40.0}
    adapting = empty_scene.SceneAdaptation(given, **times)
    pixels = {
        at: Pixel(*(float(e[at]) for e in (first, spread, second, second_spread)), model=model, **times)
        for at in np.ndindex(shape)
    }
    time, image = 0.0, np.zeros(shape)
    for _ in range(60):
        time += float(rng.choice([0.0, 5.0, 20.0]))
        moved = rng.random(shape) < 0.15  # most surfaces stay for a while
        image = np.where(moved, rng.choice([0.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0], shape), image)
        noisy = (image + rng.normal(0, 0.03, shape) * (image > 0)).astype(np.float32)
        adapting.update(noisy, time)
        for at, pixel in pixels.items():
            pixel.update(float(noisy[at]), time)
        scene = adapting.scene
        for at, pixel in pixels.items():
            found = [scene.first[at], scene.spread[at], scene.second[at], scene.second_spread[at]]
            assert found == pytest.approx([*pixel.modes[0], *pixel.modes[1]], rel=1e-3, abs=1e-4, nan_ok=True), at
    assert scene.frames == 65
    assert (scene.first != first).mean() > 0.5
    assert scene.second_share[np.isnan(scene.second)].tolist() == [0.0] * int(np.isnan(scene.second).sum())
    assert scene.second_share[~np.isnan(scene.second)] == pytest.approx(0.3)


def test_scenes_are_of_images_spread_over_the_first_frames():
    """Frame k shows a wall at 10 + k m, no two of which are one surface: the last seen of the equally rare."""
    sensors = (Sensor("a", MODEL, np.eye(4)), Sensor("b", MODEL, np.eye(4)))
    asked = []

    class Frames(list):
        def __getitem__(self, k):
            asked.append(k)
            return super().__getitem__(k)

    images = [np.full(MODEL.shape, 10.0 + k, np.float32) for k in range(9)]
    frames = Frames(Frame(sensors, (image, image * 2), Objects.empty(), 0.1 * k, k) for k, image in enumerate(images))
    one, other = empty_scene.learn_empty_scenes(frames, sample=3)
    assert (asked, one.frames) == ([0, 4, 8], 3)
    assert (one.name, one.first[0, 0], other.first[0, 0]) == ("a", 18.0, 36.0)
    asked.clear()
    assert empty_scene.learn_empty_scenes(frames, sample=3, frames=5)[0].first[0, 0] == 14.0
    assert asked == [0, 2, 4]
    asked.clear()
    assert empty_scene.learn_empty_scenes(frames, sample=1)[0].frames == 1
    assert empty_scene.learn_empty_scenes(frames, frames=99)[0].frames == 9
    assert empty_scene.Scenes(frames, sample=3)(1).name == "b"


def test_known_scenes_have_the_models_spread_near_by_too_and_are_seen_to_their_edge():
    image = np.full(MODEL.shape, 0.5, np.float32)
    image[0, 0] = 0.0
    scene = empty_scene.EmptyScene.of(Sensor("s", MODEL, np.eye(4)), image)
    assert scene.spread[0, :2].tolist() == pytest.approx([0.0, deviation(0.5)])
    assert (scene.share == 1).all()
    edges = np.full(MODEL.shape, 20.0, np.float32)
    spread = np.full(MODEL.shape, 0.25, np.float32)
    second, none = np.full(MODEL.shape, np.nan, np.float32), np.zeros(MODEL.shape, np.float32)
    wide = empty_scene.EmptyScene("s", MODEL, edges, spread, none, second, none, none, 1)
    assert wide.shows(edges + 1.0).all()
    assert wide.shows(edges - 1.0).all()
    assert not wide.shows(edges + 1.001).any()
    with pytest.raises(ValueError, match="read-only"):
        wide.first[0, 0] = 1.0
