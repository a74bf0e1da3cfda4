"""Whole files: what is there is there whole, and nothing is left behind."""

import errno
import os
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from toolkit.runtime import files


def test_files_replace_what_was_there_with_links_and_permissions(tmp_path):
    path = tmp_path / "new" / "file.txt"
    files.write_text(path, "one")
    files.write_bytes(path, b"two")
    assert path.read_bytes() == b"two"
    assert [each.name for each in path.parent.iterdir()] == ["file.txt"]
    path = tmp_path / "file"
    files.write_text(path, "a")
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    path.chmod(0o640)
    files.write_text(path, "b")
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_link_stays_a_link_and_what_it_points_to_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "file", tmp_path / "link"
    real.write_text("old")
    link.symlink_to(real)
    files.write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["link", "real"]


def test_a_full_disk_is_one_line_that_names_the_file_and_what_was_there_stays(tmp_path):
    path = tmp_path / "file.h5"
    path.write_text("good")

    def fill() -> None:
        with files.writing(path) as unfinished:
            assert unfinished.suffix == ".h5"
            unfinished.write_text("torn")
            raise OSError(errno.ENOSPC, "full")

    with pytest.raises(OSError, match=r"cannot write .*file\.h5: No space left on device") as told:
        fill()
    assert told.value.errno == errno.ENOSPC
    assert "\n" not in str(told.value)
    assert path.read_text() == "good"
    assert [each.name for each in tmp_path.iterdir()] == ["file.h5"]


def test_errors_leave_nothing_and_pass_as_they_are(tmp_path):
    def fail() -> None:
        with files.writing(tmp_path / "file"):
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        fail()
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot write"):
        files.write_text(tmp_path / "file" / "below", "x")
    path = tmp_path / "file"
    files.reserve(path, 100_000)
    assert path.read_bytes() == b""
    with pytest.raises(OSError, match=r"."):
        files.reserve(path, 1 << 62)
    assert path.read_bytes() == b""


def test_outputs_are_no_inputs_and_replaced_when_told(tmp_path):
    (tmp_path / "in").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "in")
    os.link(tmp_path / "in", tmp_path / "hard")
    for name in ("in", "link", "hard", "./in"):
        with pytest.raises(ValueError, match="is what is read"):
            files.check_output(tmp_path / name, inputs=[tmp_path / "other", tmp_path / "in"], overwrite=True)
    with pytest.raises(ValueError, match="is what is read"):
        files.check_output(Path("not-there"), inputs=["./not-there"])
    (tmp_path / "there").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").write_text("")
    files.check_output(tmp_path / "new")
    files.check_output(tmp_path / "empty")
    for name in ("there", "full"):
        with pytest.raises(FileExistsError, match="--overwrite"):
            files.check_output(tmp_path / name)
        files.check_output(tmp_path / name, overwrite=True)


def test_a_place_of_the_caller_s_own_for_what_is_unfinished(tmp_path):
    own, path = tmp_path / "own.unfinished", tmp_path / "new" / "file"
    with files.writing(path, own) as unfinished:
        assert unfinished == own
        assert not own.exists()
        own.write_text("whole")
    assert path.read_text() == "whole"
    assert not own.exists()


def test_files_written_together_are_all_there_or_none(tmp_path):
    def write(folder, error=None):
        with files.writing_together(folder) as unfinished:
            for name in ("a", "b"):
                files.write_text(unfinished / name, "new")
            if error:
                raise error

    full = OSError(errno.ENOSPC, "full")
    with pytest.raises(OSError, match=r"cannot write .*deep: No space left on device; make room"):
        write(tmp_path / "new" / "deep", full)
    assert list(tmp_path.iterdir()) == []
    write(tmp_path / "out")
    (tmp_path / "out" / "a").write_text("old")
    for error in (full, ValueError("other")):
        with pytest.raises(type(error)):
            write(tmp_path / "out", error)
    assert {each.name: each.read_text() for each in (tmp_path / "out").iterdir()} == {"a": "old", "b": "new"}


def test_sound_json_is_read_and_damaged_json_is_one_line(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('\ufeff{"a": [1, 2.5, null]}', encoding="utf-8")
    assert files.read_json(path) == files.parse_json('{"a": [1, 2.5, null]}') == {"a": [1, 2.5, None]}
    for content, says in (
        (b'{"a": 1,\n', r"a\.json: not JSON from line 2 on"),
        (b"[" * 100_000, r"a\.json: its lists or objects are nested too deep"),
        *((b'{"a":' * 100_000, "nested too deep"), (b"1" * 5000, "thousands of digits")),
        (b"\xff\xfe", r"a\.json: not a text file \(byte 0 is not UTF-8\)"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=says) as error:
            files.read_json(path)
        assert "\n" not in str(error.value)


ARRAYS: dict[str, np.ndarray] = {"a": np.arange(1000, dtype=np.float32), "empty": np.zeros((0, 7))}


def test_arrays_written_are_read_here_and_by_numpy(tmp_path):
    files.write_arrays(tmp_path / "new" / "x.npz", ARRAYS)
    found = files.read_arrays(tmp_path / "new" / "x.npz")
    assert found.keys() == ARRAYS.keys()
    assert all(found[name].dtype == ARRAYS[name].dtype and (found[name] == ARRAYS[name]).all() for name in ARRAYS)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.npz"]
    with np.load(tmp_path / "new" / "x.npz") as file:
        assert (file["a"] == ARRAYS["a"]).all()
    np.save(tmp_path / "a.npy", np.arange(3))
    np.savez(tmp_path / "b.npz", x=np.arange(3), y=np.eye(2))
    assert files.load_arrays(tmp_path / "a.npy")[""].tolist() == [0, 1, 2]
    assert set(files.load_arrays(tmp_path / "b.npz")) == {"x", "y"}


def test_arrays_cut_turned_or_not_ours_are_refused(tmp_path):
    files.write_arrays(tmp_path / "x.npz", ARRAYS)
    content = (tmp_path / "x.npz").read_bytes()
    damaged = [content[:length] for length in (0, 1, 40, -30, -1)]
    damaged += [content[:k] + bytes([content[k] ^ 4]) + content[k + 1 :] for k in range(0, len(content), 17)]
    for each in damaged:
        (tmp_path / "y.npz").write_bytes(each)
        with pytest.raises(ValueError, match="checksum"):
            files.read_arrays(tmp_path / "y.npz")
    with pytest.raises(FileNotFoundError):
        files.read_arrays(tmp_path / "none.npz")
    content = BytesIO()
    np.savez(content, a=np.array([{}], object))
    (tmp_path / "x.npz").write_bytes(content.getvalue())
    with pytest.raises(ValueError, match="checksum"):
        files.read_arrays(tmp_path / "x.npz")
    for value in (content.getvalue(), b"no archive"):
        (tmp_path / "x.npz").write_bytes(value + sha256(value).digest())
        with pytest.raises(ValueError, match="no plain arrays"):
            files.read_arrays(tmp_path / "x.npz")
    whole = npy(np.arange(9.0))
    for content in (
        *(b"", b"junk", b"PK\x03\x04junk", b"\x80\x04N.", whole[:100]),
        *(whole.replace(b"(9,)", b"(99"), whole.replace(b"'<f8'", b"'<q8'"), npy(np.array([{"a": 1}], dtype=object))),
    ):
        (tmp_path / "a.npy").write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.npy cannot be read as \.npy array") as error:
            files.load_arrays(tmp_path / "a.npy")
        assert "\n" not in str(error.value)


def npy(array):
    stream = BytesIO()
    np.save(stream, array)
    return stream.getvalue()
