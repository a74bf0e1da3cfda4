"""Empty scenes beside a slow oracle that takes one pixel after the other."""

import hashlib
import math
from itertools import pairwise, product

import numpy as np
import pytest

from toolkit.calibration import empty_scene, pixel_clusters, recording_scenes
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SolidStateLidar
from toolkit.sensors.sensor import Sensor

MODEL = SolidStateLidar(rows=6, columns=8)
CAMERA = DepthCamera(width=16, height=12, stride=2)  # as many pixels


def deviation(value, model=MODEL):
    return (
        float(np.ravel(model.deviation(np.array([value], np.float32)))[0])
        if math.isfinite(value)
        else 0.0
    )


def images(n, seed, model=MODEL):
    """Pixels that see up to four surfaces, some of them in runs, each with noise, and pixels that
    see a new one each time."""
    rng = np.random.default_rng(seed)
    made = np.zeros((n, *model.shape), np.float32)
    for row, column in np.ndindex(model.shape):
        kind = rng.integers(5)
        if kind == 0:
            depth = rng.uniform(3, 60, n)
        else:
            surfaces = rng.choice(
                [0.0, 0.6, 8.0, 8.4, 20.0, 21.0, 50.0], rng.integers(1, 5), replace=False
            )
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
        if (math.isinf(value) and math.isfinite(before)) or (
            math.isfinite(value) and value - before > gap
        ):
            parts.append([])
        parts[-1].append(value)
    return parts


def mode_of(part, n, model):
    """Median, spread, share, least and greatest of one cluster."""
    finite = [value if math.isfinite(value) else 0.0 for value in part]
    median = float(np.median(finite))
    spread = max(
        1.4826 * float(np.median(np.abs(np.array(finite) - median))), deviation(median, model)
    )
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
    comes = sum(
        now and not before for before, now in zip([False, *present[:-1]], present, strict=True)
    )
    return (
        mode_of(parts[far], n, model),
        mode_of(near, n, model),
        comes >= 0.25 * share * (1 - share) * n,
    )


@pytest.mark.parametrize(
    ("n", "model"), [(1, MODEL), (2, MODEL), (3, CAMERA), (13, CAMERA), (20, MODEL), (41, MODEL)]
)
def test_clusters_of_every_pixel_are_an_oracles(n, model):
    stack = images(n, n, model)
    far, near, flickers = pixel_clusters.find_clusters(stack, model)
    for at in np.ndindex(model.shape):
        wanted_far, wanted_near, wanted = pixel_modes(stack[(slice(None), *at)], model)
        assert [each[at] for each in far] == pytest.approx(wanted_far, rel=1e-4, abs=1e-5), at
        assert [each[at] for each in near] == pytest.approx(
            wanted_near, rel=1e-4, abs=1e-5, nan_ok=True
        ), at
        assert flickers[at] == wanted, at


def random_mode(seed, shape=MODEL.shape):
    rng = np.random.default_rng(seed)
    median = np.where(rng.random(shape) < 0.2, 0, np.exp(rng.uniform(-1.0, 4.1, shape))).astype(
        np.float32
    )
    spread = np.where(median > 0, rng.uniform(0.01, 0.2, shape), 0).astype(np.float32)
    share = rng.choice([0.3, 0.5, 0.9], shape).astype(np.float32)
    return pixel_clusters.PixelMode(median, spread, share, median - 1, median + 1)


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
    asked = np.array([[0.0, 0.2, 0.7, 5.5, 20.0, 59.0, 200.0, np.nan]], np.float32)
    logs = [math.log(each) if each > 0 else 0.0 for each in asked[0]]
    wanted = [
        max(np.interp(at, middles, usual), deviation(d))
        for at, d in zip(logs, np.nan_to_num(asked[0]), strict=True)
    ]
    found = pixel_clusters.usual_spread(far, MODEL)(asked)
    assert found[0] == pytest.approx(wanted, rel=1e-5)
    nothing = far._replace(share=np.zeros_like(far.share))
    assert pixel_clusters.usual_spread(nothing, MODEL)(asked)[0] == pytest.approx(
        [deviation(d) for d in np.nan_to_num(asked[0])]
    )
    sky = pixel_clusters.PixelMode(*(np.zeros((2, 2), np.float32) for _ in range(5)))
    sky = sky._replace(share=np.ones((2, 2), np.float32))
    assert pixel_clusters.usual_spread(sky, MODEL)(
        np.full((1, 1), 9.0, np.float32)
    ).item() == pytest.approx(deviation(9.0))


def narrowed(values, least, greatest, usual):
    """Densest stretch of a pixel's measurements, the farthest of equal ones."""
    inside = sorted(value for value in values if least <= value <= greatest)
    counts = [
        sum(start <= value <= start + 8 * usual for value in inside[k:])
        for k, start in enumerate(inside)
    ]
    begin = max(range(len(inside)), key=lambda k: (counts[k], k))
    part = inside[begin : begin + counts[begin]]
    median = float(np.median(part))
    off = sorted(abs(value - median) for value in part)[(len(part) - 1) // 2]
    return median, min(max(1.4826 * off, usual), 2 * usual), len(part) / len(values)


@pytest.mark.parametrize("at_once", [256, 7])
def test_broad_clusters_are_narrowed_as_an_oracle_does(limits, at_once):
    limits(pixel_clusters, BATCH_PX=at_once)
    rng = np.random.default_rng(5)
    stack = rng.choice(np.linspace(9.0, 12.0, 61), (23, *MODEL.shape)).astype(np.float32)
    stack[:, rng.random(MODEL.shape) < 0.5] *= 1.5
    usual = rng.uniform(0.011, 0.05, MODEL.shape).astype(np.float32)
    least = np.sort(stack, axis=0)[3]
    mode = pixel_clusters.PixelMode(
        np.median(stack, axis=0),
        usual * rng.choice([1.0, 2.0, 2.1, 9.0], MODEL.shape).astype(np.float32),
        np.ones(MODEL.shape, np.float32),
        least,
        np.sort(stack, axis=0)[-2],
    )
    before = [each.copy() for each in mode]
    found = pixel_clusters.narrow_broad(mode, usual, list(stack))
    for at in np.ndindex(MODEL.shape):
        if mode.spread[at] <= 2 * usual[at]:
            assert [each[at] for each in found] == [each[at] for each in mode]
            continue
        values, (low, high) = (
            stack[(slice(None), *at)].tolist(),
            (mode.least[at], mode.greatest[at]),
        )
        wanted = narrowed(values, low, high, float(usual[at]))
        assert (found.median[at], found.spread[at], found.share[at]) == pytest.approx(
            wanted, rel=1e-4
        ), at
    assert all(np.array_equal(one, other) for one, other in zip(mode, before, strict=True))


def continues(near, far, row, column):
    """Whether a neighbour's farthest surface goes on in a nearer one, and is another than the
    pixel's own plane."""
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
    median = np.where(
        rng.random(MODEL.shape) < 0.2,
        np.nan,
        rng.choice([10.0, 10.03, 11.95, 5.0, 0.5], MODEL.shape),
    )
    spread = rng.choice([0.001, 0.02], MODEL.shape).astype(np.float32)
    near = pixel_clusters.PixelMode(
        median.astype(np.float32), spread, *(np.zeros(MODEL.shape, np.float32),) * 3
    )
    found = pixel_clusters.mark_continuation(near, far)
    wanted = [
        [continues(near, far, i, j) for j in range(MODEL.shape[1])] for i in range(MODEL.shape[0])
    ]
    assert found.tolist() == wanted
    assert 0 < found.sum() < found.size


@pytest.mark.parametrize(
    ("depth", "elsewhere", "another"), [(0.5, 0.5, False), (1.0, 0.0, True), (10.0, 0.0, True)]
)
def test_surfaces_within_a_metre_and_beside_nothing_returned(depth, elsewhere, another):
    """A plane goes on as itself however near it is; where nothing returns there is no plane to go
    on."""
    far = np.full(MODEL.shape, elsewhere, np.float32)
    far[2, 2] = depth
    spread, none = np.full(MODEL.shape, 0.001, np.float32), np.zeros(MODEL.shape, np.float32)
    found = pixel_clusters.mark_continuation(
        pixel_clusters.PixelMode(np.full(MODEL.shape, depth, np.float32), spread, none, none, none),
        far,
    )
    assert found[2, 3] == continues(
        pixel_clusters.PixelMode(np.full(MODEL.shape, depth), spread, none, none, none), far, 2, 3
    )
    assert found[2, 3] == another


def test_blocks_of_rows_and_pixels_are_learnt_alike(limits, spy):
    """However few measurements are sorted at once."""

    def learnt():
        learner = empty_scene.SceneLearner(Sensor("s", MODEL, np.eye(4)))
        for image in images(20, 5):
            learner.add(image)
        return learner.scene()

    calls = spy(empty_scene, "find_clusters")
    whole = learnt()
    assert np.isfinite(whole.second).any()
    assert [call.args[0].shape[1] for call in calls] == [6]  # all at once, usually
    calls.clear()
    for block, wanted in ((1, [1] * 6), (400, [2] * 3), (639, [3] * 2), (640, [4, 2]), (960, [6])):
        limits(empty_scene, BLOCK_VALUES=block)
        assert learnt().digest == whole.digest
        # rows of 8 columns in 20 images, as many as fit
        assert [call.args[0].shape[1] for call in calls] == wanted
        calls.clear()


def test_scenes_are_of_images_spread_over_the_first_frames():
    """Frame k shows a wall at 10 + k m, no two of which are one surface: the last seen of the
    equally rare."""
    sensors = (Sensor("a", MODEL, np.eye(4)), Sensor("b", MODEL, np.eye(4)))
    asked = []

    class Frames(list):
        def __getitem__(self, k):
            asked.append(k)
            return super().__getitem__(k)

    images = [np.full(MODEL.shape, 10.0 + k, np.float32) for k in range(9)]
    frames = Frames(
        Frame(sensors, (image, image * 2), Objects.empty(), 0.1 * k, k)
        for k, image in enumerate(images)
    )
    one, other = empty_scene.learn_empty_scenes(frames, sample=3)
    assert (asked, one.frames) == ([0, 4, 8], 3)
    assert (one.name, one.first[0, 0], other.first[0, 0]) == ("a", 18.0, 36.0)
    asked.clear()
    assert empty_scene.learn_empty_scenes(frames, sample=3, frames=5)[0].first[0, 0] == 14.0
    assert asked == [0, 2, 4]
    asked.clear()
    assert empty_scene.learn_empty_scenes(frames, sample=1)[0].frames == 1
    assert empty_scene.learn_empty_scenes(frames, frames=99)[0].frames == 9
    assert recording_scenes.Scenes(frames, sample=3)(1).name == "b"
    assert recording_scenes.Scenes(frames[:1])(1).first[0, 0] == 20.0
    assert empty_scene.learn_empty_scenes(frames, frames=1)[0].frames == 1
    with pytest.raises(ValueError, match="no cloud has a point"):
        recording_scenes.Scenes([])["a"]


def test_known_scenes_have_the_models_spread_near_by_too_and_are_seen_to_their_edge():
    image = np.full(MODEL.shape, 0.5, np.float32)
    image[0, 0] = 0.0
    scene = empty_scene.EmptyScene.from_render(Sensor("s", MODEL, np.eye(4)), image)
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
    both = empty_scene.EmptyScene("s", MODEL, edges - 10, spread, none, edges, spread, none, 1)
    assert both.shows(edges + 1.0).all()
    assert both.shows(edges - 1.0).all()
    assert not both.shows(edges + 1.001).any()


def uniform(value):
    return np.full(MODEL.shape, value, np.float32)


def test_every_image_of_the_sample_counts():
    """A wall at 10 m in two of three images, and one at 30 m in the last."""
    sensors = (Sensor("a", MODEL, np.eye(4)),)
    frames = [
        Frame(sensors, (uniform(10.0 + 20 * (k == 2)),), Objects.empty(), 0.1 * k, k)
        for k in range(3)
    ]
    (found,) = empty_scene.learn_empty_scenes(frames, sample=3)
    assert found.first[0, 0] == 10.0


def learnt_of(columns):
    """Scene of images whose pixels show these depths from the left, one list for each image."""
    learner = empty_scene.SceneLearner(Sensor("s", MODEL, np.eye(4)))
    for depths in columns:
        learner.add(np.broadcast_to(np.array(depths, np.float32), MODEL.shape).copy())
    return learner.scene()


def test_a_tenth_of_the_images_and_before_nothing_half_of_them_are_enough():
    """The second pixel shows what stands beside it in 2 of 20 images, or in 2 of 21."""
    for count, enough in ((20, True), (21, False)):
        found = learnt_of(
            [[10.0, 10.0 if k in (3, 9) else 20.0, *[20.0] * 6] for k in range(count)]
        )
        assert bool(found.second[0, 1] == 10.0) == enough
        assert found.first[0, 1] == 20.0
    for count, seen, enough in ((20, 10, True), (20, 9, False)):  # elsewhere nothing returns at all
        found = learnt_of(
            [
                [0.0, 0.0, 0.0, 0.0, 20.0 if k % 2 == 0 and k < 2 * seen else 0.0] + [0.0] * 3
                for k in range(count)
            ]
        )
        assert found.first[0, 4] == 0.0
        assert bool(found.second[0, 4] == 20.0) == enough


def test_measurements_just_a_gap_apart_are_one_cluster(limits):
    """The gap at 8 m is 2 m, and at 10 m 2.5: 8 and 10 are one surface, 13 another."""
    limits(pixel_clusters, GAP_SIGMAS=0.0)
    limits(pixel_clusters, GAP_SHARE=0.25)
    far, near, _ = pixel_clusters.find_clusters(
        np.stack([uniform(each) for each in (8.0, 10.0, 13.0, 13.0)]), MODEL
    )
    assert (far.median[0, 0], far.share[0, 0]) == (13.0, 0.5)
    assert (near.median[0, 0], near.least[0, 0], near.greatest[0, 0], near.share[0, 0]) == (
        9.0,
        8.0,
        10.0,
        0.5,
    )


def test_the_densest_stretch_has_both_its_ends_and_may_be_a_single_measurement():
    """Eight usual spreads are a metre. Measurements outside the cluster do not count, however many
    they are."""

    def narrow(values, least, greatest, usual):
        one = [np.full((1, 1), each, np.float32) for each in (11.0, 9.0, 1.0, least, greatest)]
        images = [np.full((1, 1), each, np.float32) for each in values]
        found = pixel_clusters.narrow_broad(
            pixel_clusters.PixelMode(*one), np.full((1, 1), usual, np.float32), images
        )
        return found.median.item(), found.share.item()

    assert narrow((10.0, 10.5, 11.0, 13.0, 15.0), 10.0, 15.0, 0.125) == pytest.approx((10.5, 3 / 5))
    assert narrow((10.0, 12.0, 14.0, 20.0), 10.0, 14.0, 0.125) == pytest.approx((14.0, 1 / 4))


def test_a_surface_is_continued_to_the_edge_of_the_image_and_of_its_noise(limits):
    def mask(far, near, spread):
        none = np.zeros(MODEL.shape, np.float32)
        return pixel_clusters.mark_continuation(
            pixel_clusters.PixelMode(near, uniform(spread), none, none, none), far
        )

    far, near = uniform(30.0), uniform(np.nan)
    far[2, 3], near[2, 4], near[4, 4] = 10.0, 11.0, 11.001
    assert np.argwhere(mask(far, near, 0.25)).tolist() == [[2, 4]]  # four spreads off, and no more
    close = uniform(0.05)  # beyond the edge is no surface at no distance
    assert not mask(uniform(10.0), close, 0.02).any()
    limits(pixel_clusters, MIN_SURFACE_GAP_SHARE=0.5)
    far, near = uniform(4.0), uniform(np.nan)
    # just half as far again as the plane through the pixel and the one before
    far[2, 3], near[2, 2] = (6.0, 6.0)
    assert not mask(far, near, 0.01).any()
    far[2, 3], near[2, 2] = 6.25, 6.25
    assert np.argwhere(mask(far, near, 0.01)).tolist() == [[2, 2]]


def test_digests_are_of_name_model_frames_and_all_images():
    """Messages name a scene by it, so it is the same tomorrow."""
    model = SolidStateLidar(rows=6, columns=8, horizontal_fov=2.0, vertical_fov=0.5)
    depths = [20.0, 0.25, 0.5, np.nan, 0.0, 0.0]
    names = ("first", "spread", "share", "second", "second_spread", "second_share")
    found = empty_scene.EmptyScene(
        "s", model, **dict(zip(names, map(uniform, depths), strict=True)), frames=3
    )
    said = (
        '["s", {"class": "SolidStateLidar", "columns": 8, "horizontal_fov": 2.0, "max_range": '
        '150.0, "rows": 6, "sigma": 0.02, "sigma_per_metre": 0.0003, "vertical_fov": 0.5}, 3]'
    )
    images = b"".join(uniform(depth).tobytes() for depth in depths)
    assert found.digest == hashlib.sha256(said.encode() + images).hexdigest()


def test_one_pixel_that_is_infinite_or_negative_spoils_a_scene():
    good = {
        name: uniform(0.5)
        for name in ("first", "spread", "share", "second", "second_spread", "second_share")
    }
    for wrong in (np.inf, -0.5):
        bad = uniform(0.5)
        bad[3, 3] = wrong
        for name in good:
            with pytest.raises(ValueError, match=f"{name} of 's' must be finite and 0 or more"):
                empty_scene.EmptyScene("s", MODEL, **good | {name: bad}, frames=1)
    with pytest.raises((ValueError, TypeError), match=r"must be float32 of|parameter 'share'"):
        empty_scene.EmptyScene("s", MODEL, **good | {"share": uniform(0.5).astype(float)}, frames=1)
