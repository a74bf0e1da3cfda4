"""The codecs that go by a name: the one place where they are looked up."""

from __future__ import annotations

from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.link.range_images import RangeImages

CODECS = ("paper", "range-images")


def codec_named(name: str, *, step: float = 0.02) -> Codec:
    """The codec of that name; step: of measurements (m), where it has one. Raises ValueError that lists what there is.

    >>> codec_named("range-images", step=0.04)
    RangeImages(step=0.04)
    """
    codecs: dict[str, Codec] = dict(zip(CODECS, (PAPER, RangeImages(step)), strict=True))
    if name not in codecs:
        raise ValueError(f"there is no codec {name!r}: choose among {', '.join(CODECS)}")
    return codecs[name]
