"""Catalogue of sensor models with prices, in TOML.

currency = "EUR"
pole_price = 4000          # of one ordinary mount, whose price is 1; without it, mounts are
                           # priced in the currency

[[sensor]]
name = "camera"            # as shown in the plan's tables
model = "DepthCamera"      # or in words: depth-camera
price = 1500
fov_deg = 90               # fields of the model; angles in degrees, named so

[rates]                    # in addition to prices: cable and permit for each pole, power and
                           # upkeep for each sensor and year
cable = 900
power = 60
years = 10

[report]                   # head of the report: title, client, author, date, logo (a PNG or JPEG
                           # file in the same folder)
client = "City of Elm"
"""

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from warnings import catch_warnings, simplefilter

from toolkit.runtime.reading import name_errors, read_bytes
from toolkit.runtime.text_values import parse_toml
from toolkit.sensors.models import find_model_class, make_model
from toolkit.sensors.sensor import SensorModel, find_angles

CATALOGUE_KEYS = ("currency", "pole_price", "sensor", "rates", "report")
RATES = {  # what each rate is paid for, and True if it is paid every year
    "cable": ("pole", False),
    "permit": ("pole", False),
    "power": ("sensor", True),
    "upkeep": ("sensor", True),
}
_HEAD_KEYS = ("title", "client", "author", "date", "logo")  # keys of the table [report]
_MAX_LOGO_BYTES = 200_000
MAX_LOGO_PX = 4000  # largest width and height of a logo
_MAX_HEAD_LETTERS = 200  # largest number of characters of an entry of [report]
DEFAULT_YEARS = 10.0  # over which yearly rates are added up
SENSOR_KEYS = ("name", "model", "price")  # in addition to the fields of a model
DEGREE_SUFFIX = "_deg"


@dataclass(frozen=True)
class PricedModel:
    """Sensor model that may be bought.

    Attributes:
        name: Name in tables.
        model: The model.
        price: Price of one sensor in the catalogue's currency."""

    name: str
    model: SensorModel
    price: float


@dataclass(frozen=True)
class SensorCatalogue:
    """Models that may be bought.

    Attributes:
        models: Models with names and prices.
        currency: Currency of the prices.
        pole_price: Price of one ordinary mount, None if mounts are priced in the currency.
        digest: SHA-256 of the file and the logo.
        rates: Amounts in the currency by name, some of `RATES`; yearly ones are for one year.
        years: Years over which yearly rates are added up.
        report: Head of a report: some of title, client, author, date, logo (a data URI).
    """

    models: tuple[PricedModel, ...]
    currency: str = ""
    pole_price: float | None = None
    digest: str = ""
    rates: dict[str, float] = field(default_factory=dict)
    years: float = DEFAULT_YEARS
    report: dict[str, str] = field(default_factory=dict)

    def get_name(self, model: SensorModel) -> str:
        """Name of a model in the catalogue. Raises ValueError if the catalogue lacks it."""
        for priced in self.models:
            if priced.model == model:
                return priced.name
        raise ValueError(
            f"the catalogue has no {model}: it has "
            f"{', '.join(priced.name for priced in self.models)}"
        )


def load_sensor_catalogue(path: str | Path) -> SensorCatalogue:
    """Load a catalogue of sensor models with prices from a TOML file.

    The format is in this module's docstring; a logo is looked for in the file's folder.
    Raises OSError, and ValueError in one line that names the wrong entry.
    """
    content = read_bytes(path)
    with name_errors(path):
        document = parse_toml(content)
    unknown = [key for key in document if key not in CATALOGUE_KEYS]
    if unknown:
        raise ValueError(
            f"{path}: {unknown[0]} is unknown: a catalogue has {', '.join(CATALOGUE_KEYS)}"
        )
    currency = document.get("currency", "")
    if not isinstance(currency, str):
        raise ValueError(f"{path}: currency must be a text, got {currency!r:.60}")
    pole_price = (
        _read_price(document["pole_price"], f"{path}: pole_price")
        if "pole_price" in document
        else None
    )
    rows = document.get("sensor")
    if not isinstance(rows, list) or not rows:
        raise ValueError(
            f"{path}: sensor must be a list of at least one sensor: begin each with [[sensor]]"
        )
    models = tuple(_read_sensor(row, f"{path}: sensor[{i}]") for i, row in enumerate(rows))
    for i, priced in enumerate(models):
        for j, earlier in enumerate(models[:i]):
            if priced.name == earlier.name:
                raise ValueError(
                    f"{path}: sensor[{i}].name {priced.name!r} is taken by sensor[{j}]: rename one"
                )
            if priced.model == earlier.model:
                raise ValueError(
                    f"{path}: sensor[{i}] is the same model as sensor[{j}]: leave one of them out"
                )
    rate_entries = _read_table(document, path, "rates", (*RATES, "years"))
    rates = {key: _read_price(value, f"{path}: rates.{key}") for key, value in rate_entries}
    years = rates.pop("years", DEFAULT_YEARS)
    head = {key: str(value) for key, value in _read_table(document, path, "report", _HEAD_KEYS)}
    for key, text in head.items():
        if not text.isprintable() or len(text) > _MAX_HEAD_LETTERS:
            raise ValueError(
                f"{path}: report.{key} must be one line of up to {_MAX_HEAD_LETTERS} characters: "
                "shorten it"
            )
    if "logo" in head:
        head["logo"] = _read_logo(Path(path).parent / head["logo"], f"{path}: report.logo")
    digest = sha256(content + head.get("logo", "").encode()).hexdigest()
    return SensorCatalogue(
        models=models,
        currency=currency,
        pole_price=pole_price,
        digest=digest,
        rates=rates,
        years=years,
        report=head,
    )


def _read_logo(path: Path, where: str) -> str:
    """Read a PNG or JPEG picture as a data URI, after a check that it is complete.

    where: Place in the catalogue, for errors. Raises FileNotFoundError; ValueError for another kind
    of file or one that is too large."""
    from PIL import Image

    if not path.is_file():
        raise FileNotFoundError(
            f"{where}: no file {path}: give a PNG or JPEG file beside the catalogue"
        )
    content = read_bytes(path)
    if len(content) > _MAX_LOGO_BYTES:
        raise ValueError(
            f"{where} must have at most {_MAX_LOGO_BYTES // 1000} kB, got {len(content) // 1000}: "
            "shrink it"
        )
    size: tuple[int, ...]
    try:
        with catch_warnings():
            simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(BytesIO(content), formats=("PNG", "JPEG")) as picture:
                size = picture.size
                kind = str(picture.format).lower()
                if max(size) <= MAX_LOGO_PX:
                    picture.load()
    except Image.DecompressionBombError:
        size = (MAX_LOGO_PX + 1,)
    except (OSError, SyntaxError, ValueError):
        raise ValueError(
            f"{where}: {path.name} is no whole PNG or JPEG picture: save it again"
        ) from None
    if max(size) > MAX_LOGO_PX:
        raise ValueError(
            f"{where} must have at most {MAX_LOGO_PX} pixels a side, got more in {path.name}: "
            "shrink it"
        )
    return f"data:image/{kind};base64,{b64encode(content).decode()}"


def _read_table(
    document: Mapping[str, object], path: str | Path, name: str, keys: Sequence[str]
) -> Iterable[tuple[str, object]]:
    """Keys and values of a table of the catalogue; empty if the catalogue lacks it.

    Args:
        document: The parsed TOML file.
        path: Path of the file, for errors.
        name: Name of the table.
        keys: Keys that it may have.

    Raises ValueError for any other key, or if it is no table."""
    table = document.get(name, {})
    if not isinstance(table, Mapping):
        raise ValueError(
            f"{path}: {name} must be a table, got {table!r:.60}: begin it with [{name}]"
        )
    unknown = [key for key in table if key not in keys]
    if unknown:
        raise ValueError(f"{path}: {name}.{unknown[0]} is unknown: {name} has {', '.join(keys)}")
    return table.items()


def _read_sensor(row: object, where: str) -> PricedModel:
    """Model and price of one [[sensor]] of the file.

    where: Path of the file and place of the sensor, for errors. Raises ValueError for an entry that
    is missing, unknown or wrong."""
    if not isinstance(row, Mapping):
        raise ValueError(f"{where} must be a table, got {row!r:.60}: begin it with [[sensor]]")
    for key in ("model", "price"):
        if key not in row:
            raise ValueError(
                f"{where}.{key} is missing: a sensor has name, model, price and fields of its model"
            )
    name = row.get("name", row["model"])
    for key, text in (("model", row["model"]), ("name", name)):
        if not isinstance(text, str) or not text:
            raise ValueError(f"{where}.{key} must be a non-empty text, got {text!r:.60}")
    try:
        angles = find_angles(find_model_class(row["model"]))
    except ValueError as error:
        raise ValueError(f"{where}.model: {error}") from None
    # fields of the model as the file names them (angles with `DEGREE_SUFFIX`), True for angles
    file_fields = {
        f"{field}{DEGREE_SUFFIX}" if is_angle else field: is_angle
        for field, is_angle in angles.items()
    }
    values = {key: value for key, value in row.items() if key not in SENSOR_KEYS}
    for key, value in list(values.items()):  # a list, as `values` changes
        if key not in file_fields:
            raise ValueError(f"{where}.{key} is unknown: the model has {', '.join(file_fields)}")
        if file_fields[key]:
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float)
                or not math.isfinite(value)
            ):
                raise ValueError(
                    f"{where}.{key} must be a finite number of degrees, got {value!r:.60}"
                )
            values[key.removesuffix(DEGREE_SUFFIX)] = math.radians(values.pop(key))
    try:
        model = make_model(row["model"], values)
        hash(model)  # TypeError for a value that cannot be a key, such as a list
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from None
    return PricedModel(name, model, price=_read_price(row["price"], f"{where}.price"))


def _read_price(value: object, where: str) -> float:
    """Return a value of the catalogue as a price, a number from 0 up.

    where: Place of the value in the catalogue, for errors. Raises ValueError for other values."""
    # bool is an int in Python
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e15:
        raise ValueError(f"{where} must be a number from 0 up, got {value!r:.60}")
    return float(value)
