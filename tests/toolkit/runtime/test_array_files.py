from hashlib import sha256
from io import BytesIO

import numpy as np
import pytest

from toolkit.runtime.array_files import read_arrays, write_arrays

ARRAYS: dict[str, np.ndarray] = {"a": np.arange(1000, dtype=np.float32), "empty": np.zeros((0, 7))}


def test_what_is_written_is_read(tmp_path):
    write_arrays(tmp_path / "new" / "x.npz", ARRAYS)
    found = read_arrays(tmp_path / "new" / "x.npz")
    assert found.keys() == ARRAYS.keys()
    assert all(found[name].dtype == ARRAYS[name].dtype and (found[name] == ARRAYS[name]).all() for name in ARRAYS)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.npz"]


@pytest.mark.parametrize("length", [0, 1, 40, -30, -1])
def test_files_cut_off_are_refused(tmp_path, length):
    write_arrays(tmp_path / "x.npz", ARRAYS)
    content = (tmp_path / "x.npz").read_bytes()
    (tmp_path / "x.npz").write_bytes(content[:length])
    with pytest.raises(ValueError, match="checksum"):
        read_arrays(tmp_path / "x.npz")


def test_a_turned_bit_is_found(tmp_path):
    write_arrays(tmp_path / "x.npz", ARRAYS)
    content = (tmp_path / "x.npz").read_bytes()
    for place in range(0, len(content), 17):
        turned = bytearray(content)
        turned[place] ^= 4
        (tmp_path / "y.npz").write_bytes(turned)
        with pytest.raises(ValueError, match="checksum"):
            read_arrays(tmp_path / "y.npz")


def test_numpy_reads_them_too(tmp_path):
    write_arrays(tmp_path / "x.npz", ARRAYS)
    with np.load(tmp_path / "x.npz") as file:
        assert (file["a"] == ARRAYS["a"]).all()


def test_what_is_missing_or_not_ours_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "none.npz")
    np.savez(tmp_path / "objects.npz", a=np.array([{}], object))
    with pytest.raises(ValueError, match="checksum"):
        read_arrays(tmp_path / "objects.npz")


def test_objects_are_refused_whatever_the_checksum_says(tmp_path):
    content = BytesIO()
    np.savez(content, a=np.array([{}], object))
    for value in (content.getvalue(), b"no archive"):
        (tmp_path / "x.npz").write_bytes(value + sha256(value).digest())
        with pytest.raises(ValueError, match="no plain arrays"):
            read_arrays(tmp_path / "x.npz")
