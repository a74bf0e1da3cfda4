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

# limits of a picture that is uploaded
MAX_PICTURE_BYTES = 40_000_000
MAX_PIXELS = 60_000_000
MAX_SIDE_PX = 1600  # along the longer side of the picture that is kept
MIN_POINT_GAP_M = 0.5  # least distance (m) between the two points
# limits of the width of a pixel on the ground
MIN_SCALE_M = 1e-6
MAX_SCALE_M = 1e5


@dataclass(frozen=True)
class GroundPicture:
    """Picture on the ground, in the frame of the site. Raises ValueError if a field does not fit.

    Attributes:
        name: Name of the file that was uploaded.
        file: Name of the kept file in the folder of the project.
        width: Width of the kept picture (px).
        height: Height of the kept picture (px).
        x: Position of the picture's middle along the site's x axis (m).
        y: Position of the picture's middle along the site's y axis (m).
        scale: Width of a pixel on the ground (m).
        turn: Turn about the middle, counter-clockwise (rad); at 0 the picture's right is +x.
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
        """Raise ValueError for a field of another type or beyond its limits, as in a file."""
        picture = JsonObject(vars(self), "picture")
        check_name(picture.get("name", str))
        for key in ("width", "height"):
            picture.whole(key, low=1, high=MAX_SIDE_PX)
        for key in ("x", "y", "turn"):
            picture.number(key, -MAX_COORDINATE_M, MAX_COORDINATE_M)
        picture.number("scale", MIN_SCALE_M, MAX_SCALE_M)
        if not re.fullmatch(r"picture-[0-9a-f]{12}\.jpg", picture.get("file", str)):
            raise ValueError(
                f"picture.file must be picture- and twelve digits and .jpg, got {self.file!r:.60}"
            )

    def place(self, spots: Sequence[Sequence[float]], numbers: Sequence[float]) -> "GroundPicture":
        """Return the picture scaled, turned and shifted so that two points fit.

        spots: present positions (x, y) of the two points (m); numbers: x, y, x, y of their right
        positions (m), or only their right distance (m), which leaves the first point and the turn
        as they are. Raises ValueError for points that are closer than `MIN_POINT_GAP_M`, and for
        other numbers."""
        # points are complex numbers x + yj, so that a ratio scales and turns
        start, end = (complex(x, y) for x, y in spots)
        middle = complex(self.x, self.y)
        if len(numbers) == 1:
            direction = (end - start) / max(abs(end - start), 1e-9)  # 1e-9: no division by 0
            right_end = start + numbers[0] * direction
            numbers = start.real, start.imag, right_end.real, right_end.imag
        if len(numbers) != 4 or not np.isfinite(numbers).all():
            raise ValueError(
                "two points need x y x y or their distance (m), got "
                f"{' '.join(map(str, numbers))!r:.60}"
            )
        new_start = complex(numbers[0], numbers[1])
        new_end = complex(numbers[2], numbers[3])
        if min(abs(end - start), abs(new_end - new_start)) < MIN_POINT_GAP_M:
            raise ValueError(
                f"the two points must be {MIN_POINT_GAP_M:g} m apart or more: choose others"
            )
        ratio = (new_end - new_start) / (end - start)
        new_middle = new_start + ratio * (middle - start)
        return replace(
            self,
            x=new_middle.real,
            y=new_middle.imag,
            scale=self.scale * abs(ratio),
            turn=float(self.turn + np.angle(ratio)),
        )

    def read(self, folder: Path) -> UInt8[np.ndarray, "height width 3"]:
        """Read the pixels (RGB, upper row first) of the kept file.

        folder: folder of the project. Raises ValueError for a damaged file, OSError for a missing
        one."""
        return _decode((folder / self.file).read_bytes(), self.name)


def keep_picture(
    name: str, content: bytes, folder: Path, area: Float64[np.ndarray, "4"]
) -> GroundPicture:
    """Write a PNG or JPEG picture to a folder, and return it placed over an area.

    The file is a JPEG of at most `MAX_SIDE_PX` along its longer side, named by the content's hash.

    Args:
        name: Name of the file that was uploaded.
        content: Bytes of the uploaded file.
        folder: Folder of the project.
        area: xmin, ymin, xmax and ymax (m) of the area; the picture gets its middle and width.

    Raises:
        ValueError: For a long name, a damaged picture, and one of more than `MAX_PICTURE_BYTES` or
            `MAX_PIXELS`.
    """
    check_name(name)
    if len(content) > MAX_PICTURE_BYTES:
        limit = f"{MAX_PICTURE_BYTES // 10**6} MB"
        raise ValueError(
            f"a picture must have at most {limit}, got {len(content) / 1e6:.0f}: shrink it"
        )
    from PIL import Image

    picture = Image.fromarray(_decode(content, name))
    picture.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX))
    jpeg = BytesIO()
    picture.save(jpeg, "JPEG", quality=85)
    file = f"picture-{sha256(content).hexdigest()[:12]}.jpg"
    write_bytes(folder / file, jpeg.getvalue())
    xmin, ymin, xmax, ymax = area.tolist()
    return GroundPicture(
        name=name,
        file=file,
        width=picture.width,
        height=picture.height,
        x=(xmin + xmax) / 2,
        y=(ymin + ymax) / 2,
        scale=(xmax - xmin) / picture.width,
    )


def _decode(content: bytes, name: str) -> UInt8[np.ndarray, "height width 3"]:
    """RGB pixels of the content of a PNG or JPEG file. name: name of the file, for the error."""
    from PIL import Image

    try:
        with Image.open(BytesIO(content), formats=("PNG", "JPEG")) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise ValueError("it has too many pixels")
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        limit = f"{MAX_PIXELS // 10**6} million pixels"
        raise ValueError(
            f"{name} is no whole PNG or JPEG picture of up to {limit}: save it again"
        ) from None
