"""The schemes that go by a name."""

import pytest

from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES, scheme_of


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


def test_parameters_are_in_the_digest():
    assert len({Hybrid().digest, Hybrid(5.0).digest, Hybrid(metric="published").digest, Early().digest}) == 4
