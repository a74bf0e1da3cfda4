"""`GroundPicture`: a picture under the scene, such as an aerial photo or a plan, placed by two
points."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np

from placement_env.live.variant import check_name
from toolkit.arrays import Float64, UInt8
from toolkit.geometry import MAX_COORDINATE_M
from toolkit.runtime.json_object import JsonObject
from toolkit.runtime.writing import write_bytes

# size of a picture that is uploaded
MOST_PICTURE_BYTES = 40_000_000
MOST_PIXELS = 60_000_000
SHOWN_PIXELS = 1600  # along its longer side, as it is kept
NEAREST = 0.5  # m between the two points
# width of a pixel
MIN_SCALE_M = 1e-6
MAX_SCALE_M = 1e5


@dataclass(frozen=True)
class GroundPicture:
    """Picture on the ground.

    Attributes:
        name: Name of the file that was uploaded.
        file: Name of the file in the folder of the project.
        width: Width (px).
        height: Height (px).
        x: Position of the middle (m).
        y: Position of the middle (m).
        scale: Width of a pixel (m).
        turn: Turn counter-clockwise (rad).
    """

    name: str
    file: str
    width: int
    height: int
    x: float
    y: float
    scale: float
    turn: float = 0.0

    def __post_init__(self) -> None:
        picture = JsonObject(vars(self), "picture")
        check_name(picture.get("name", str))
        for key in ("width", "height"):
            picture.whole(key, 1, SHOWN_PIXELS)
        for key in ("x", "y", "turn"):
            picture.number(key, -MAX_COORDINATE_M, MAX_COORDINATE_M)
        picture.number("scale", MIN_SCALE_M, MAX_SCALE_M)
        if not re.fullmatch(r"picture-[0-9a-f]{12}\.jpg", picture.get("file", str)):
            raise ValueError(
                f"picture.file must be picture- and twelve digits and .jpg, got {self.file!r:.60}"
            )

    def place(self, spots: Sequence[Sequence[float]], numbers: Sequence[float]) -> "GroundPicture":
        """Scale, turn and shift the picture by two points.

        spots: present positions of the points (m); numbers: x, y, x, y of their right positions, or
        only their right distance, with the first point in place (m). Raises ValueError for points
        that are closer than `NEAREST`, and for other numbers."""
        (start, end), middle = (complex(x, y) for x, y in spots), complex(self.x, self.y)
        if len(numbers) == 1:
            far = start + numbers[0] * (end - start) / max(abs(end - start), 1e-9)
            numbers = start.real, start.imag, far.real, far.imag
        if len(numbers) != 4 or not np.isfinite(numbers).all():
            raise ValueError(
                "two points need x y x y or their distance (m), got "
                f"{' '.join(map(str, numbers))!r:.60}"
            )
        first = complex(*numbers[:2])
        last = complex(*numbers[2:])
        if min(abs(end - start), abs(last - first)) < NEAREST:
            raise ValueError(f"the two points must be {NEAREST:g} m apart or more: choose others")
        ratio = (last - first) / (end - start)
        moved = first + ratio * (middle - start)
        turn = float(self.turn + np.angle(ratio))
        return replace(self, x=moved.real, y=moved.imag, scale=self.scale * abs(ratio), turn=turn)

    def read(self, folder: Path) -> UInt8[np.ndarray, "height width 3"]:
        """Read the pixels. Raises ValueError for a damaged file, OSError for a missing one."""
        return _decode((folder / self.file).read_bytes(), self.name)


def keep_picture(
    name: str, content: bytes, folder: Path, area: Float64[np.ndarray, "4"]
) -> GroundPicture:
    """Keep a PNG or JPEG picture in a folder, as wide as an area (m) at first. Raises ValueError
    for a long name, a damaged picture and one of more than `MOST_PICTURE_BYTES` or
    `MOST_PIXELS`."""
    check_name(name)
    if len(content) > MOST_PICTURE_BYTES:
        limit = f"{MOST_PICTURE_BYTES // 10**6} MB"
        raise ValueError(
            f"a picture must have at most {limit}, got {len(content) / 1e6:.0f}: shrink it"
        )
    from PIL import Image

    picture = Image.fromarray(_decode(content, name))
    picture.thumbnail((SHOWN_PIXELS, SHOWN_PIXELS))
    content_kept = BytesIO()
    picture.save(content_kept, "JPEG", quality=85)
    file = f"picture-{sha256(content).hexdigest()[:12]}.jpg"
    write_bytes(folder / file, content_kept.getvalue())
    xmin, ymin, xmax, ymax = area.tolist()
    middle = (xmin + xmax) / 2, (ymin + ymax) / 2
    return GroundPicture(name, file, *picture.size, *middle, (xmax - xmin) / picture.width)


def _decode(content: bytes, name: str) -> UInt8[np.ndarray, "height width 3"]:
    from PIL import Image

    try:
        with Image.open(BytesIO(content), formats=("PNG", "JPEG")) as picture:
            if picture.width * picture.height > MOST_PIXELS:
                raise ValueError("it has too many pixels")
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        limit = f"{MOST_PIXELS // 10**6} million pixels"
        raise ValueError(
            f"{name} is no whole PNG or JPEG picture of up to {limit}: save it again"
        ) from None
