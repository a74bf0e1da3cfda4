"""The codecs that go by a name."""

import pytest

from toolkit.detection.codec import PAPER, check_codec
from toolkit.detection.link.codecs import CODECS, codec_named
from toolkit.detection.link.range_images import RangeImages


def test_each_goes_by_its_name():
    assert codec_named("paper") is PAPER
    assert codec_named("range-images") == RangeImages(0.02)
    assert codec_named("range-images", step=0.08) == RangeImages(0.08)
    assert all(check_codec(codec_named(name)) for name in CODECS)


def test_what_is_none_is_refused():
    with pytest.raises(ValueError, match="choose among paper, range-images"):
        codec_named("zip")
    with pytest.raises(ValueError, match="step must be"):
        codec_named("range-images", step=0.0)
