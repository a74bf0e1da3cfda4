"""Whole files: what is there is there whole, and nothing is left behind."""

import errno
import itertools
import math
import os
import threading
import zipfile
from hashlib import sha256
from io import BytesIO
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
from toolkit.datasets.pose_files import read_poses
from toolkit.datasets.record_values import load_json
from toolkit.runtime import array_files, output_checks, reading, text_values, writing
from toolkit.runtime.hdf5 import open_hdf5


def test_files_replace_what_was_there_with_links_and_permissions(tmp_path):
    path = tmp_path / "new" / "file.txt"
    writing.write_text(path, "one")
    writing.write_bytes(path, b"two")
    assert path.read_bytes() == b"two"
    assert [each.name for each in path.parent.iterdir()] == ["file.txt"]
    path = tmp_path / "file"
    writing.write_text(path, "a")
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    path.chmod(0o640)
    writing.write_text(path, "b")
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_link_stays_a_link_and_what_it_points_to_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "file", tmp_path / "link"
    real.write_text("old")
    link.symlink_to(real)
    writing.write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["link", "real"]


def test_a_full_disk_is_one_line_that_names_the_file_and_what_was_there_stays(tmp_path):
    path = tmp_path / "file.h5"
    path.write_text("good")

    def fill() -> None:
        with writing.writing(path) as unfinished:
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
        with writing.writing(tmp_path / "file"):
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        fail()
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot write"):
        writing.write_text(tmp_path / "file" / "below", "x")
    path = tmp_path / "file"
    writing.reserve(path, 100_000)
    assert path.read_bytes() == b""
    with pytest.raises(OSError, match=r"."):
        writing.reserve(path, 1 << 62)
    assert path.read_bytes() == b""


def test_outputs_are_no_inputs_and_replaced_when_told(tmp_path):
    (tmp_path / "in").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "in")
    os.link(tmp_path / "in", tmp_path / "hard")
    for name in ("in", "link", "hard", "./in"):
        with pytest.raises(ValueError, match="is what is read"):
            output_checks.check_output(
                tmp_path / name, inputs=[tmp_path / "other", tmp_path / "in"], overwrite=True
            )
    with pytest.raises(ValueError, match="is what is read"):
        output_checks.check_output(Path("not-there"), inputs=["./not-there"])
    (tmp_path / "there").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").write_text("")
    output_checks.check_output(tmp_path / "new")
    output_checks.check_output(tmp_path / "empty")
    for name in ("there", "full"):
        with pytest.raises(FileExistsError, match="--overwrite"):
            output_checks.check_output(tmp_path / name)
        output_checks.check_output(tmp_path / name, overwrite=True)


def test_a_place_of_the_caller_s_own_for_what_is_unfinished(tmp_path):
    own, path = tmp_path / "own.unfinished", tmp_path / "new" / "file"
    with writing.writing(path, own) as unfinished:
        assert unfinished == own
        assert not own.exists()
        own.write_text("whole")
    assert path.read_text() == "whole"
    assert not own.exists()


def test_files_written_together_are_all_there_or_none(tmp_path):
    def write(folder, error=None):
        with writing.writing_together(folder) as unfinished:
            for name in ("a", "b"):
                writing.write_text(unfinished / name, "new")
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
    assert {each.name: each.read_text() for each in (tmp_path / "out").iterdir()} == {
        "a": "old",
        "b": "new",
    }


def test_what_a_killed_process_left_is_taken_over_but_not_what_is_being_written(tmp_path):
    (tmp_path / ".file.0.unfinished").write_text("torn")
    (tmp_path / ".mine").write_text("")
    with writing.writing(tmp_path / "file") as one, writing.writing(tmp_path / "file") as other:
        assert one.name == ".file.0.unfinished"
        assert one.read_text() == ""
        assert other != one
        writing.write_text(tmp_path / "file", "third")
        assert one.exists()
        assert other.exists()
    assert sorted(each.name for each in tmp_path.iterdir()) == [".mine", "file"]


def test_without_locks_what_another_writer_may_hold_is_left_to_it(tmp_path, fail):
    """Some network disks have no locks."""
    (tmp_path / ".file.0.unfinished").write_text("another's")
    fail("fcntl", "flock", OSError(errno.ENOLCK, "No locks available"))
    writing.write_text(tmp_path / "file", "new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        ".file.0.unfinished": "another's",
        "file": "new",
    }


def test_the_file_that_the_next_writer_begins_is_left_to_it(tmp_path, monkeypatch):
    path = tmp_path / "file"
    descriptors = []
    replace = Path.replace

    def replace_and_begin(source, target):
        replace(source, target)
        descriptors.append(writing.take(source))  # as another process does at this very moment

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace_and_begin)
        writing.write_text(path, "first")
    os.close(*descriptors)
    assert sorted(each.name for each in tmp_path.iterdir()) == [".file.0.unfinished", "file"]


def test_the_folder_that_the_next_writer_begins_is_left_to_it(tmp_path, monkeypatch):
    rename = Path.rename

    def rename_and_begin(source, target):
        rename(source, target)
        source.mkdir()

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", rename_and_begin)
        with writing.writing_folder(tmp_path / "out") as folder:
            writing.write_text(folder / "a", "new")
    assert sorted(each.name for each in tmp_path.iterdir()) == [".out.0.unfinished", "out"]
    assert (tmp_path / "out" / "a").read_text() == "new"


@pytest.mark.parametrize("is_folder", [False, True])
@pytest.mark.parametrize("moment", ["mkdir", "open", "fstat"])
def test_what_is_removed_while_it_is_taken_is_made_again(tmp_path, monkeypatch, moment, is_folder):
    path = tmp_path / "folder" / "lock"
    module = Path if moment == "mkdir" else os
    function = getattr(module, moment)
    removed = []

    def remove(*args, **kwargs):
        """Do as the owner of the lock, who removes it at the end, and its folder if it can."""
        if not removed:
            removed.append(path)
            path.rmdir() if is_folder else path.unlink()
            path.parent.rmdir()
        return function(*args, **kwargs)

    path.parent.mkdir()
    path.mkdir() if is_folder else path.touch()
    with monkeypatch.context() as patch:
        patch.setattr(module, moment, remove)
        descriptor = writing.take(path, folder=is_folder)
    assert removed
    assert os.path.samestat(os.fstat(descriptor), path.stat())
    assert writing.take(path, folder=is_folder) is None
    os.close(descriptor)


def test_a_file_that_can_never_be_made_is_no_endless_loop(tmp_path, monkeypatch):
    def refuse(*args):
        raise FileNotFoundError

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(FileNotFoundError):
        writing.take(tmp_path / "lock")


@pytest.mark.parametrize("before", ["missing", "empty", "ours", "killed while moving"])
def test_a_folder_appears_whole_or_stays_as_it_was(tmp_path, before):
    out = tmp_path / "new" / "out"
    if before != "missing":
        out.mkdir(parents=True)
    if before in ("ours", "killed while moving"):
        (out / writing.WRITTEN).write_text("" if before == "ours" else writing.UNFINISHED)
        (out / "old").mkdir()
    names = sorted(each.name for each in out.iterdir()) if out.exists() else None

    def write(error=None):
        output_checks.check_new_folder(out, overwrite=before == "ours")
        with writing.writing_folder(out) as folder:
            writing.write_text(folder / "deep" / "a", "new")
            assert not (out / "deep").exists()
            if error:
                raise error

    with pytest.raises(OSError, match=r"cannot write .*out: No space left on device"):
        write(OSError(errno.ENOSPC, "full"))
    with pytest.raises(FileNotFoundError, match="of the input"):  # its words stay
        write(FileNotFoundError(errno.ENOENT, "of the input"))
    assert (sorted(each.name for each in out.iterdir()) if out.exists() else None) == names
    left = (out if out.exists() else out.parent) / f"{'' if out.exists() else '.out'}.0.unfinished"
    left.mkdir(parents=True)
    (left / "torn").write_text("")
    with pytest.warns(UserWarning, match="which a killed run left, is removed and begun anew"):
        write()
    assert sorted(each.name for each in out.iterdir()) == [writing.WRITTEN, "deep"]
    assert (out / writing.WRITTEN).read_text() == ""
    assert [each.name for each in out.parent.iterdir()] == ["out"]


def test_outputs_below_an_input_above_one_or_among_files_of_others_are_refused(tmp_path):
    (tmp_path / "rec" / "lidar").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "rec")
    for out in ("rec/labels.json", "rec/lidar/new/file", "link/x"):
        with pytest.raises(ValueError, match=r"is inside .*rec, which is read"):
            output_checks.check_output(tmp_path / out, inputs=[tmp_path / "rec"], overwrite=True)
    with pytest.raises(ValueError, match="files that coview did not write there"):
        output_checks.check_new_folder(tmp_path, overwrite=True)
    (tmp_path / writing.WRITTEN).touch()
    output_checks.check_new_folder(tmp_path, overwrite=True)
    with pytest.raises(FileExistsError, match="--overwrite"):
        output_checks.check_new_folder(tmp_path)
    with pytest.raises(ValueError, match="rec/lidar, which is read"):
        output_checks.check_new_folder(
            tmp_path, inputs=[tmp_path / "rec" / "lidar"], overwrite=True
        )


def test_sound_json_is_read_and_damaged_json_is_one_line(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('\ufeff{"a": [1, 2.5, null]}', encoding="utf-8")
    assert (
        text_values.read_json(path)
        == text_values.parse_json('{"a": [1, 2.5, null]}')
        == {"a": [1, 2.5, None]}
    )
    for content, says in (
        (b'{"a": 1,\n', r"a\.json: not JSON from line 2 on"),
        (b"[" * 100_000, r"a\.json: its lists or objects are nested too deep"),
        *(
            (b'{"a":' * 100_000, "nested too deep"),
            (b"[%s]" % (b"1" * 400), "a number of 400 digits"),
        ),
        (b"\xff\xfe", r"a\.json: not a text file \(byte 0 is not UTF-8\)"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=says) as error:
            text_values.read_json(path)
        assert "\n" not in str(error.value)


ARRAYS: dict[str, np.ndarray] = {"a": np.arange(1000, dtype=np.float32), "empty": np.zeros((0, 7))}


def test_a_pipe_is_read_to_its_end(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    content = bytes(range(256)) * 8192  # 2 MiB, of which a pipe holds a part at a time
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(content,), daemon=True)
    writer.start()
    assert reading.read_bytes(tmp_path / "pipe") == content
    writer.join()


def test_pipes_that_are_silent_and_devices_are_no_files(tmp_path, limits):
    limits(reading, MAX_SILENCE_S=0.01)
    os.mkfifo(tmp_path / "pipe")
    readers = (
        text_values.read_json,
        load_sensor_catalogue,
        array_files.read_arrays,
        array_files.load_arrays,
        open_hdf5,
        load_json,
        read_poses,
    )
    for path, read in product((tmp_path / "pipe", Path("/dev/zero")), readers):
        with pytest.raises(ValueError, match=r"is a pipe.* save its content to a file"):
            read(path)
    limits(reading, MAX_PIPE_BYTES=10)
    writer = threading.Thread(target=(tmp_path / "pipe").write_text, args=("x" * 100,))
    writer.start()
    with pytest.raises(ValueError, match="does not end"):
        reading.read_bytes(tmp_path / "pipe")
    writer.join()


def test_arrays_written_are_read_here_and_by_numpy(tmp_path):
    array_files.write_arrays(tmp_path / "new" / "x.npz", ARRAYS)
    found = array_files.read_arrays(tmp_path / "new" / "x.npz")
    assert found.keys() == ARRAYS.keys()
    assert all(
        found[name].dtype == ARRAYS[name].dtype and (found[name] == ARRAYS[name]).all()
        for name in ARRAYS
    )
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.npz"]
    with np.load(tmp_path / "new" / "x.npz") as file:
        assert (file["a"] == ARRAYS["a"]).all()
    np.save(tmp_path / "a.npy", np.arange(3))
    np.savez(tmp_path / "b.npz", x=np.arange(3), y=np.eye(2))
    assert array_files.load_arrays(tmp_path / "a.npy")[""].tolist() == [0, 1, 2]
    assert set(array_files.load_arrays(tmp_path / "b.npz")) == {"x", "y"}


def test_arrays_cut_turned_or_not_ours_are_refused(tmp_path):
    array_files.write_arrays(tmp_path / "x.npz", ARRAYS)
    content = (tmp_path / "x.npz").read_bytes()
    damaged = [content[:length] for length in (0, 1, 40, -30, -1)]
    damaged += [
        content[:k] + bytes([content[k] ^ 4]) + content[k + 1 :] for k in range(0, len(content), 17)
    ]
    for each in damaged:
        (tmp_path / "y.npz").write_bytes(each)
        with pytest.raises(ValueError, match="checksum"):
            array_files.read_arrays(tmp_path / "y.npz")
    with pytest.raises(FileNotFoundError):
        array_files.read_arrays(tmp_path / "none.npz")
    content = BytesIO()
    np.savez(content, a=np.array([{}], object))
    (tmp_path / "x.npz").write_bytes(content.getvalue())
    with pytest.raises(ValueError, match="checksum"):
        array_files.read_arrays(tmp_path / "x.npz")
    for value in (content.getvalue(), b"no archive"):
        (tmp_path / "x.npz").write_bytes(value + sha256(value).digest())
        with pytest.raises(ValueError, match="cannot be read as"):
            array_files.read_arrays(tmp_path / "x.npz")
    whole = npy(np.arange(9.0))
    for content in (
        *(b"", b"junk", b"PK\x03\x04junk", b"\x80\x04N.", whole[:100]),
        *(
            whole.replace(b"(9,)", b"(99"),
            whole.replace(b"'<f8'", b"'<q8'"),
            npy(np.array([{"a": 1}], dtype=object)),
        ),
    ):
        (tmp_path / "a.npy").write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.npy cannot be read as \.npy array") as error:
            array_files.load_arrays(tmp_path / "a.npy")
        assert "\n" not in str(error.value)


def test_arrays_that_unpack_to_gigabytes_or_are_none_are_refused(tmp_path):
    declared = npy(np.arange(9.0)).replace(b"(9,), }      ", b"(999999999,)}")
    for content, says in (
        (declared, "unpacks to 7.5 GiB"),
        (b"a text", "magic"),
        (b"zeros", "unpacks to 2.0 GiB"),
    ):
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("a.npy", content)
        whole = (tmp_path / "a.npz").read_bytes()
        if content == b"zeros":  # what the archive's directory says
            place = whole.rindex(b"PK\x01\x02") + 24
            whole = whole[:place] + (1 << 31).to_bytes(4, "little") + whole[place + 4 :]
        (tmp_path / "a.npz").write_bytes(whole)
        with pytest.raises(ValueError, match=says):
            array_files.load_arrays(tmp_path / "a.npz")
    (tmp_path / "a.npy").write_bytes(declared)
    with pytest.raises(ValueError, match=r"a\.npy cannot be read as .*unpacks to 7.5 GiB"):
        array_files.load_arrays(tmp_path / "a.npy")


def npy(array):
    stream = BytesIO()
    np.save(stream, array)
    return stream.getvalue()


BOMB = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, name in itertools.pairwise("abcdefgh")
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB, "more than 1000000 values, aliases included"),
        ("a: &a [*a]", "more than 1000000 values"),
        ("a: {b: 1, c: 2, b: 3}", "the key 'b' twice"),
        *(
            ("a: [1", "expected"),
            ("[" * 900, "nested too deep|while parsing"),
            ("a: !!python/object:os.system x", "tag"),
        ),
    ],
)
def test_yaml_that_would_fill_the_memory_or_says_two_things_is_refused(text, says):
    with pytest.raises(ValueError, match=says) as error:
        text_values.parse_yaml(text)
    assert "\n" not in str(error.value)


def test_yaml_with_few_aliases_is_read_and_json_has_no_key_twice():
    assert text_values.parse_yaml("a: &a [1, 2]\nb: *a\n7: {<<: {x: 1}, y: 2}") == {
        "a": [1, 2],
        "b": [1, 2],
        7: {"x": 1, "y": 2},
    }
    assert text_values.parse_yaml("") is None
    with pytest.raises(ValueError, match="the key 'b' twice: restore"):
        text_values.parse_json('{"a": {"b": 1, "b": 2}}')


def test_a_whole_file_written_to_an_unfinished_one_keeps_its_lock(tmp_path):
    path = tmp_path / "table.csv"
    with writing.writing(path) as unfinished:
        writing.write_text(unfinished, "first")
        with writing.writing(path) as other:
            assert other != unfinished
            other.write_text("second")
    assert path.read_text() == "first"
    assert [each.name for each in tmp_path.iterdir()] == ["table.csv"]


@pytest.mark.parametrize("name", ["/etc/passwd", "a/../../b", "..", "a\0b"])
def test_file_names_in_files_stay_below_their_data_set(name):
    with pytest.raises(ValueError, match="leads out of"):
        reading.resolve_below("set", name)
    assert reading.resolve_below("set", "samples/a.bin") == Path("set/samples/a.bin")


def test_links_may_lead_anywhere_within_their_folder(tmp_path):
    root, other = tmp_path / "set", tmp_path / "set2"
    (root / "a").mkdir(parents=True)
    other.mkdir()
    (root / "b").symlink_to(root / "a")
    (root / "a" / "loop").symlink_to(root)
    (tmp_path / "link").symlink_to(root)
    reading.check_links(root)
    reading.check_links(tmp_path / "link")
    for target in ("/etc/passwd", other, "../../set2", "/no/where"):
        (root / "a" / "out").symlink_to(target)
        for place in (root, tmp_path / "link"):
            with pytest.raises(ValueError, match=r"a/out leads out of .*: put a copy in its place"):
                reading.check_links(place)
        (root / "a" / "out").unlink()


def test_what_json_lacks_becomes_null_however_deep():
    value = {"ap": [0.5, math.nan], "bounds": (-math.inf, 2), "names": ["nan", None, True]}
    assert text_values.replace_infinite([value, math.inf]) == [
        {"ap": [0.5, None], "bounds": [None, 2], "names": ["nan", None, True]},
        None,
    ]
