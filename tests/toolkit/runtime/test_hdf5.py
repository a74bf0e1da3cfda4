"""HDF5 on a disk that is full: one error, wherever it strikes, and the process lives."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from toolkit.runtime import hdf5
from toolkit.runtime.hdf5 import hdf5_file


@pytest.fixture
def file(tmp_path):
    with h5py.File(tmp_path / "a.hdf5", "w") as made:
        made["numbers"] = np.arange(6.0).reshape(2, 3)
        made["words"] = "hello"
        made["group/inside"] = np.arange(3)
        made["nowhere"] = h5py.SoftLink("/not/there")
        other = str(tmp_path / "pipe")
        os.mkfifo(other)  # opening it would wait for ever
        made["away"], made["else"] = h5py.ExternalLink(other, "x"), h5py.ExternalLink(other, "/")
        made.create_dataset("raw", (4,), "f8", external=[(other, 0, 32)])
        layout = h5py.VirtualLayout((4,), "f8")
        layout[:] = h5py.VirtualSource(other, "x", (4,))
        made.create_virtual_dataset("group/virtual", layout)
        made["type"] = np.dtype("f8")
        made["nothing"] = h5py.Empty("f8")
        made.create_dataset("vast", (10**9, 10**3), np.float32, chunks=True)
        made["numbers"].attrs.update(unit="m", gone=h5py.Empty("f8"))
        yield made


@pytest.mark.parametrize("libver", ["earliest", "v108", "v110"])
def test_a_file_that_is_cut_off_tells_its_whole_size(tmp_path, libver):
    path = tmp_path / "cut.hdf5"
    with h5py.File(path, "w", libver=libver) as made:
        made["numbers"] = np.arange(1000)
    content = path.read_bytes()
    path.write_bytes(content[:500])
    with pytest.raises(OSError, match=f"is cut off: 500 of {len(content)} bytes"):
        hdf5.open_hdf5(path)
    if content[8] == 0:  # version 1 has one number of 2 bytes more, and two reserved bytes
        longer = content[:8] + b"\1" + content[9:24] + b"\x20\0\0\0" + content[24:]
        path.write_bytes(longer[:500])
        with pytest.raises(OSError, match=f"is cut off: 500 of {len(content)} bytes"):
            hdf5.open_hdf5(path)


def test_what_is_sound_is_read_and_faults_of_h5py_are_of_reading(file):
    np.testing.assert_array_equal(hdf5.array(file, "numbers", axes=2), np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(hdf5.rows(hdf5.dataset(file, "numbers"), "numbers", 1), [3, 4, 5])
    assert hdf5.text(file, "words") == "hello"
    assert hdf5.child_names(file, "group") == ["inside", "virtual"]
    assert hdf5.child_names(file, "missing") == hdf5.child_names(file, "numbers") == []
    assert hdf5.read_node_attributes(file["numbers"], "numbers") == {"unit": "m"}
    assert hdf5.contains(file, "group/inside")
    assert not hdf5.contains(file, "missing")
    says = r"^dslices cannot be read \(bad chunk\): the file is damaged"
    for kind in (RuntimeError, KeyError, TypeError, OverflowError):
        with pytest.raises(OSError, match=says), hdf5.reading("dslices"):
            raise kind("bad chunk")
    with pytest.raises(ZeroDivisionError), hdf5.reading("dslices"):
        raise ZeroDivisionError


@pytest.mark.parametrize(
    ("name", "asked", "says"),
    [
        *(("missing", {}, "'missing' is missing"), ("nowhere", {}, "nowhere is a link")),
        *(
            ("away", {}, "away is a link, which is not followed: store"),
            ("else/x", {}, "else is a link"),
        ),
        *(
            ("raw", {}, "raw has its numbers in another file"),
            ("group/virtual", {}, "numbers in another file"),
        ),
        ("group", {}, "must be a dataset of numbers, got group"),
        *(
            ("type", {}, "must be a dataset of numbers, got datatype"),
            ("nothing", {}, "must be a dataset of numbers"),
        ),
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
    if "link" in says or "another" in says:
        for follow in (hdf5.contains, hdf5.find_array, hdf5.child_names, hdf5.text):
            with pytest.raises(ValueError, match=says):
                follow(file, name)


SIZES = [0, 1, 96, 2000, 5000, 20_000, 100_000, 200_000]


def write(file, check=lambda: None):
    column = file.create_dataset(
        "column", (0,), np.float64, maxshape=(None,), chunks=(1 << 12,), compression="gzip"
    )
    for k in range(10):
        column.resize(len(column) + 3000, axis=0)
        column[-3000:] = np.random.default_rng(k).random(3000)
        file.create_dataset(f"frames/{k}", data=np.arange(50), track_times=False)
        check()


def test_what_is_written_is_read_and_errors_of_the_block_pass(tmp_path):
    with hdf5_file(tmp_path / "a.hdf5") as (file, check):
        write(file, check)
    with h5py.File(tmp_path / "a.hdf5") as file:
        assert (file["column"][-3000:] == np.random.default_rng(9).random(3000)).all()
        assert len(file["frames"]) == 10
    with hdf5_file(tmp_path / "b.hdf5") as (file, _):
        write(file)
    assert (tmp_path / "a.hdf5").read_bytes() == (tmp_path / "b.hdf5").read_bytes()
    assert (tmp_path / "a.hdf5").stat().st_size > SIZES[-1]

    def fail() -> None:
        with hdf5_file(tmp_path / "a.hdf5") as (file, _):
            write(file)
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        fail()


LIMITED = """
import gc, resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
limit = int(sys.argv[1])
from tests.toolkit.runtime.test_hdf5 import hdf5_file, write
from toolkit.runtime.writing import writing
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    with writing("a.hdf5") as unfinished, hdf5_file(unfinished) as (file, check):
        write(file, check if len(sys.argv) > 2 else lambda: None)
except OSError as error:
    gc.collect()
    sys.exit(f"{error.errno} {error}")
"""


@pytest.mark.one_in(4)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("early", [[], ["early"]])
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, size, early):
    done = subprocess.run(
        [sys.executable, "-B", "-c", LIMITED, str(size), *early],
        cwd=tmp_path,
        env={"PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1, done.stderr
    assert (
        done.stderr
        == f"{errno.EFBIG} cannot write a.hdf5: File too large; make room, or give another path\n"
    )
    assert not list(tmp_path.iterdir())
