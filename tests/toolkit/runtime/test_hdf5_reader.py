import h5py
import numpy as np
import pytest

from toolkit.runtime import hdf5_reader as hdf5


@pytest.fixture
def file(tmp_path):
    with h5py.File(tmp_path / "a.hdf5", "w") as made:
        made["numbers"] = np.arange(6.0).reshape(2, 3)
        made["words"] = "hello"
        made["group/inside"] = np.arange(3)
        made["nowhere"] = h5py.SoftLink("/not/there")
        made["type"] = np.dtype("f8")
        made["nothing"] = h5py.Empty("f8")
        made.create_dataset("vast", (10**9, 10**3), np.float32, chunks=True)
        made["numbers"].attrs.update(unit="m", gone=h5py.Empty("f8"))
        yield made


def test_what_is_sound_is_read(file):
    np.testing.assert_array_equal(hdf5.array(file, "numbers", axes=2), np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(hdf5.rows(hdf5.dataset(file, "numbers"), "numbers", 1), [3, 4, 5])
    assert hdf5.text(file, "words") == "hello"
    assert hdf5.names_in(file, "group") == ["inside"]
    assert hdf5.names_in(file, "missing") == hdf5.names_in(file, "numbers") == []
    assert hdf5.attributes_in(file["numbers"], "numbers") == {"unit": "m"}
    assert hdf5.holds(file, "group/inside")
    assert not hdf5.holds(file, "missing")


@pytest.mark.parametrize(
    ("name", "asked", "says"),
    [
        ("missing", {}, "'missing' is missing"),
        ("nowhere", {}, "is missing"),
        ("group", {}, "must be a dataset of numbers, got group"),
        ("type", {}, "must be a dataset of numbers, got datatype"),
        ("nothing", {}, "must be a dataset of numbers"),
        ("words", {}, "must hold numbers, got object"),
        ("numbers", {"axes": 1}, r"must have 1 axes, got float64 of shape \(2, 3\)"),
        ("numbers", {"kinds": "iu"}, "must hold whole numbers, got float64"),
        ("vast", {}, "claims 4000000000000 bytes, but only 0 are stored"),
    ],
)
def test_what_is_not_is_refused_in_one_line(file, name, asked, says):
    with pytest.raises(ValueError, match=says) as error:
        hdf5.array(file, name, **asked)
    assert "\n" not in str(error.value)


def test_whatever_h5py_raises_is_an_error_of_reading():
    says = r"^dslices cannot be read \(bad chunk\): the file is damaged"
    for kind in (RuntimeError, KeyError, TypeError, OverflowError):
        with pytest.raises(OSError, match=says), hdf5.reading("dslices"):
            raise kind("bad chunk")
    with pytest.raises(ZeroDivisionError), hdf5.reading("dslices"):
        raise ZeroDivisionError
