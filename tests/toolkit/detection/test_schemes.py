from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.detection.codec import PAPER
from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.scheme import Fused, Scheme, bits_sent
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES, scheme_of
from toolkit.objects import Detections

COUNTS = SimpleNamespace(sent=np.full((2, 3), 10, np.float32), far=np.full((2, 3), 4, np.float32))


@pytest.mark.parametrize("name", SCHEMES)
def test_each_goes_by_its_name(name):
    scheme = scheme_of(name)
    assert isinstance(scheme, Scheme)
    assert scheme.name == name
    assert scheme_of(scheme) is scheme
    assert scheme.sends_points or scheme.sends_boxes


def test_the_papers_are_there_in_its_order():
    assert PAPER_SCHEMES == tuple(SCHEMES)[:3] == ("early", "late", "hybrid")


@pytest.mark.parametrize("scheme", ["middle", "", None, 3, Early])
def test_what_is_none_is_refused(scheme):
    with pytest.raises((ValueError, TypeError), match="scheme"):
        scheme_of(scheme)


@pytest.mark.parametrize(("name", "points", "boxes"), [("early", 30, 0), ("late", 0, 5), ("hybrid", 12, 5)])
def test_expected_bits(name, points, boxes):
    sent = bits_sent(scheme_of(name), PAPER, COUNTS, np.full(2, 5.0))
    assert sent.tolist() == [96 * points + 256 * boxes] * 2


def test_parameters_are_in_the_digest():
    assert len({Hybrid().digest, Hybrid(5.0).digest, Hybrid(metric="published").digest, Early().digest}) == 4


def test_far_points_are_counted_by_the_radius_of_the_site():
    np.testing.assert_array_equal(Hybrid().sent_points(COUNTS), COUNTS.far)
    for own in (Hybrid(5.0), Hybrid(metric="published")):
        with pytest.raises(ValueError, match="hybrid_radius"):
            own.sent_points(COUNTS)
    distance = np.array([[5.0, 20.0, 20.5]], np.float32)
    assert Hybrid().pooled_beside(distance, 20.0).tolist() == [[False, False, True]]
    assert Hybrid(4.0).pooled_beside(distance, 20.0).all()


@pytest.mark.parametrize("radius", [-1.0, np.nan])
def test_nonsense_radii_are_refused(radius):
    with pytest.raises(ValueError, match="radius must be at least 0"):
        Hybrid(radius)


def test_kbit_per_sensor_is_the_mean():
    nothing = Detections.empty()
    assert Fused(nothing, np.array([1000, 3000])).kbit_per_sensor == 2
    assert Fused(nothing, np.zeros(0, np.int64)).kbit_per_sensor == 0
