import io

import numpy as np
import pytest

from toolkit.runtime.numpy_files import load_arrays


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def test_arrays_are_read(tmp_path):
    np.save(tmp_path / "a.npy", np.arange(3))
    np.savez(tmp_path / "b.npz", x=np.arange(3), y=np.eye(2))
    assert load_arrays(tmp_path / "a.npy")[""].tolist() == [0, 1, 2]
    assert set(load_arrays(tmp_path / "b.npz")) == {"x", "y"}


@pytest.mark.parametrize(
    "content",
    [
        b"", b"junk", b"PK\x03\x04junk", b"\x80\x04N.", npy(np.arange(9.0))[:100],
        npy(np.arange(9.0)).replace(b"(9,)", b"(99"), npy(np.arange(9.0)).replace(b"'<f8'", b"'<q8'"),
    ],
)  # fmt: skip
def test_damage_is_one_line(tmp_path, content):
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.npy is no \.npy array") as error:
        load_arrays(tmp_path / "a.npy")
    assert "\n" not in str(error.value)


def test_pickles_are_not_opened(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="is no"):
        load_arrays(tmp_path / "a.npy")
