"""Catalogues of sensors with prices: what they hold, and what is refused with the place in the
document."""

from base64 import b64decode

import numpy as np
import pytest
from PIL import Image

from placement_env.candidates.candidates import pool
from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sites.files import load_site

GOOD = """
currency = "EUR"
pole_price = 4000

[[sensor]]
name = "eye"
model = "DepthCamera"
price = 1500
fov_deg = 60.0
width = 80

[[sensor]]
model = "spinning-lidar"
price = 6000.5
"""


def written(tmp_path, text):
    path = tmp_path / "sensors.toml"
    path.write_text(text)
    return path


def test_catalogues_price_candidates_and_are_text_in_a_file(tmp_path):
    catalogue = load_sensor_catalogue(written(tmp_path, GOOD))
    assert (catalogue.currency, catalogue.pole_price, len(catalogue.digest)) == ("EUR", 4000.0, 64)
    eye, lidar = catalogue.models
    assert (eye.name, eye.model, eye.price) == ("eye", DepthCamera(fov=np.pi / 3, width=80), 1500.0)
    assert (lidar.name, lidar.model, lidar.price) == ("spinning-lidar", SpinningLidar(), 6000.5)
    assert catalogue.get_name(SpinningLidar()) == "spinning-lidar"
    with pytest.raises(ValueError, match="the catalogue has no DepthCamera"):
        catalogue.get_name(DepthCamera())
    site = load_site("tjunction")
    models = (DepthCamera(), SpinningLidar())
    both = pool(
        site,
        heights=[6.0],
        headings=2,
        tilts=[0.1],
        models=dict(zip(models, (2.0, 5.0), strict=True)),
    )
    kinds = np.array([sensor.model.kind for sensor in both.sensors])
    assert np.array_equal(
        both.prices, both.mount_prices[both.mount] + np.where(kinds == "camera", 2.0, 5.0)
    )
    free = pool(site, heights=[6.0], headings=2, tilts=[0.1], models=models)
    none = pool(site, heights=[6.0], headings=2, tilts=[0.1], models=dict.fromkeys(models, 0.0))
    assert free.digest() == none.digest() != both.digest()
    with pytest.raises(FileNotFoundError):
        load_sensor_catalogue(tmp_path / "none.toml")
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a text file"):
        load_sensor_catalogue(path)


SENSOR = '[[sensor]]\nmodel = "DepthCamera"\nprice = 1\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        *(("currency = [", "not TOML"), ("", "sensor must be a list of at least one")),
        ("sensor = 3", "sensor must be a list of at least one"),
        ("sensor = [3]", r"sensor\[0\] must be a table, got 3"),
        (
            SENSOR + "[other]\n",
            "other is unknown: a catalogue has currency, pole_price, sensor, rates, report",
        ),
        ("currency = 3\n" + SENSOR, "currency must be a text, got 3"),
        ("pole_price = -1\n" + SENSOR, "pole_price must be a number from 0 up, got -1"),
        ("pole_price = true\n" + SENSOR, "pole_price must be a number from 0 up, got True"),
        ('[[sensor]]\nmodel = "DepthCamera"\n', r"sensor\[0\].price is missing"),
        ("[[sensor]]\nprice = 3\n", r"sensor\[0\].model is missing"),
        (
            '[[sensor]]\nmodel = "Radar"\nprice = 3\n',
            r"sensor\[0\].model: unknown sensor model 'Radar'",
        ),
        ("[[sensor]]\nmodel = 3\nprice = 3\n", r"sensor\[0\].model must be a non-empty text"),
        (
            '[[sensor]]\nmodel = "DepthCamera"\nprice = nan\n',
            r"sensor\[0\].price must be a number from 0 up, got nan",
        ),
        (
            '[[sensor]]\nmodel = "DepthCamera"\nprice = "9 EUR"\n',
            r"sensor\[0\].price must be a number",
        ),
        (SENSOR + "fov = 1.5\n", r"sensor\[0\].fov is unknown: the model has .*fov_deg"),
        (SENSOR + 'fov_deg = "wide"\n', r"sensor\[0\].fov_deg must be a finite number of degrees"),
        (SENSOR + "fov_deg = inf\n", r"sensor\[0\].fov_deg must be a finite number of degrees"),
        *(
            (SENSOR + "fov_deg = 500\n", r"sensor\[0\]: "),
            (SENSOR + "width = -4\n", r"sensor\[0\]: "),
        ),
        *(
            (SENSOR + "price_eur = 4\n", r"sensor\[0\].price_eur is unknown"),
            (SENSOR + SENSOR, "taken by sensor"),
        ),
        *(
            (SENSOR + f"{name} = 1{zeros}\n", "rays")
            for name, zeros in (("width", "0" * 6), ("height", "0" * 15))
        ),
        (
            SENSOR.replace("DepthCamera", "SpinningLidar") + "channels = 1000000\n",
            r"sensor\[0\]: .*rays",
        ),
        (SENSOR + SENSOR.replace("price", 'name = "other"\nprice'), "is the same model as"),
        (
            SENSOR + "[rates]\ncabel = 3\n",
            "rates.cabel is unknown: rates has cable, permit, power, upkeep, years",
        ),
        (SENSOR + "[rates]\npower = -3\n", "rates.power must be a number from 0 up, got -3"),
        ("rates = 3\n" + SENSOR, r"rates must be a table, got 3: begin it with \[rates\]"),
        (
            SENSOR + '[report]\nclient = "a\\nb"\n',
            "report.client must be one line of up to 200 characters",
        ),
    ],
)
def test_what_is_refused(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=message) as refused:
        load_sensor_catalogue(path)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


class TestLogo:
    """A picture beside the catalogue, embedded, or refused in one line."""

    TEXT = SENSOR + '[report]\nlogo = "elm.png"\n'

    def test_png_and_jpeg_are_embedded_whole(self, tmp_path):
        path = written(tmp_path, self.TEXT)
        digests = set()
        for kind in ("png", "jpeg"):
            Image.new("RGB", (40, 20), "green").save(tmp_path / "elm.png", kind)
            catalogue = load_sensor_catalogue(path)
            head, _, coded = catalogue.report["logo"].partition(",")
            assert head == f"data:image/{kind};base64"
            assert b64decode(coded) == (tmp_path / "elm.png").read_bytes()
            digests.add(catalogue.digest)
        assert len(digests) == 2

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            (None, "report.logo: no file .*elm.png: give a PNG or JPEG file beside the catalogue"),
            (b"", "elm.png is no whole PNG or JPEG picture"),
            (b"<svg/>", "elm.png is no whole PNG or JPEG picture"),
            (b"\x89PNG\r\n\x1a\n cut off", "elm.png is no whole PNG or JPEG picture"),
            (bytes(200_001), "report.logo must have at most 200 kB, got 200"),
        ],
    )
    def test_other_files_are_refused(self, tmp_path, content, message):
        path = written(tmp_path, self.TEXT)
        if content is not None:
            (tmp_path / "elm.png").write_bytes(content)
        with pytest.raises((ValueError, OSError), match=message) as refused:
            load_sensor_catalogue(path)
        assert "\n" not in str(refused.value)
