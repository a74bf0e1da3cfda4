"""Recordings of random sites: what they promise, and that a site that fails is left out with a note."""

import numpy as np
import pytest

from toolkit.bodies.fleet import HELD_OUT, catalogue, fleet_named
from toolkit.datasets import random_recordings as module
from toolkit.datasets.random_recordings import random_recording, random_recordings
from toolkit.objects import VEHICLE


def digest(recording):
    """Comparable, and small enough to send."""
    sums = [float(image.sum()) for frame in recording.frames for image in frame.measurements]
    return recording.site.name, tuple(sums), tuple(len(frame.objects) for frame in recording.frames)


@pytest.fixture(scope="module")
def recording():
    return random_recording(seed=4, number=1, frames=3)


def test_a_recording_is_whole(recording):
    assert len(recording.frames) == 3
    sensors = recording.frames[0].sensors
    assert module.FEWEST_SENSORS <= len(sensors) <= module.MOST_SENSORS
    for frame in recording.frames:
        assert frame.sensors == sensors
        for image, empty in zip(frame.measurements, recording.empty, strict=True):
            assert image.shape == empty.shape
            assert (image[image != empty] > 0).all()  # what comes in front of the site returns something
            hidden = (image > 0) & (empty > 0)
            assert (image[hidden] <= empty[hidden]).all()
    assert any(len(frame.objects) for frame in recording.frames)


def test_bodies_are_those_of_training_a_little_stretched(recording):
    sizes = np.concatenate([f.objects.boxes[f.objects.labels == VEHICLE, 3:6] for f in recording.frames])
    training = np.array([body.size for body in catalogue() if body.label == VEHICLE])
    assert not {body.name for body in catalogue()} & set(HELD_OUT)
    stretch = sizes[:, None] / training
    nearest = np.abs(stretch - 1).max(axis=2).min(axis=1)
    assert (nearest < 0.07).all()
    assert (nearest > 1e-4).any()


def test_seed_and_number_decide(recording):
    assert digest(recording) == digest(random_recording(seed=4, number=1, frames=3))
    assert digest(recording) != digest(random_recording(seed=4, number=2, frames=3))


def test_what_fails_is_left_out_with_a_note(recording, monkeypatch):
    def drawn(seed, number, frames):
        if number == 1:
            raise ValueError("no road")
        return recording

    monkeypatch.setattr(module, "random_recording", drawn)
    counts = []
    with pytest.warns(UserWarning, match="random site 1 of seed 7 left out: ValueError: no road"):
        made = list(random_recordings(3, 2, 7, digest, workers=1, progress=counts.append))
    assert made == [digest(recording)] * 2
    assert counts == [1, 2, 3]


def test_counts_must_make_sense():
    with pytest.raises(ValueError, match="at least one site"):
        next(random_recordings(0, 2, 7, digest))


@pytest.mark.slow
def test_the_number_of_workers_changes_nothing():
    alone, helped = (list(random_recordings(3, 2, 5, digest, workers=workers)) for workers in (1, 2))
    assert alone == helped


def test_a_fleet_takes_the_place_of_the_bodies_of_training():
    own = fleet_named("own")
    first, again = (random_recording(seed=4, number=1, frames=2, fleet=own) for _ in range(2))
    (third,) = random_recordings(1, 2, 4, digest, workers=1, fleet=own)
    assert digest(first) == digest(again)
    assert third == digest(random_recording(seed=4, number=0, frames=2, fleet=own))
    sizes = np.concatenate([f.objects.boxes[f.objects.labels == VEHICLE, 3:6] for f in first.frames])
    assert len({tuple(size) for size in sizes.round(4).tolist()}) > 5
