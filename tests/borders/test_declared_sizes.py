"""Files of gigabytes, memory that is limited, complex numbers and large pictures: one line each."""

import numpy as np
import pytest

from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
from placement_env.fidelity.table import load_table
from toolkit.datasets.cloud_files import read_points
from toolkit.point_columns import name_attributes
from toolkit.runtime.array_files import write_arrays
from toolkit.runtime.reading import limit_memory, read_bytes
from toolkit.runtime.text_values import read_json


def sparse(path, size):
    with path.open("wb") as file:
        file.truncate(size)
    return path


def test_sparse_files_of_gigabytes_are_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r"has 5\.0 GiB, more than the 1 GiB that are read at a time: split it"
    ):
        read_bytes(sparse(tmp_path / "a.toml", 5 << 30))
    with pytest.raises(ValueError, match=r"has 0\.6 GiB, too much for a JSON file"):
        read_json(sparse(tmp_path / "a.json", 600 << 20))
    with pytest.raises(ValueError, match="split it"):
        read_points(sparse(tmp_path / "a.bin", 5 << 30))


def test_memory_is_limited_for_a_while():
    with limit_memory(256 << 20), pytest.raises(MemoryError):
        np.ones(1 << 29)
    assert np.ones(1 << 26).nbytes == 1 << 29


def test_complex_numbers_are_refused_by_name(tmp_path):
    axes = {"x": np.zeros(3, complex), "y": np.zeros(3), "z": np.zeros(3)}
    with pytest.raises(ValueError, match="column x must hold real numbers, got complex128"):
        name_attributes(axes)
    write_arrays(
        tmp_path / "t.npz", {"ap": np.zeros((1, 1), complex), "origin": np.zeros(2, np.uint8)}
    )
    with pytest.raises(
        ValueError, match=r"ap must hold real numbers, got complex128\): make it again"
    ):
        load_table(tmp_path / "t.npz")


@pytest.mark.parametrize("size", [(14_000, 14_000), (4001, 1)])
def test_a_logo_has_few_pixels(size, tmp_path):
    from PIL import Image

    Image.new("1", size).save(tmp_path / "logo.png")
    catalogue = tmp_path / "c.toml"
    catalogue.write_text(
        '[[sensor]]\nmodel = "DepthCamera"\nprice = 1\n[report]\nlogo = "logo.png"\n'
    )
    said = r"report\.logo must have at most 4000 pixels a side, got more in logo\.png: shrink it"
    with pytest.raises(ValueError, match=said):
        load_sensor_catalogue(catalogue)
