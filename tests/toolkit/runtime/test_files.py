"""Whole files: what is there is there whole, and nothing is left behind."""

import errno
import os
from pathlib import Path

import pytest

from toolkit.runtime.files import check_output, reserve, write_bytes, write_text, writing, writing_together


def test_it_makes_folders_replaces_what_was_there_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "new" / "file.txt"
    write_text(path, "one")
    write_bytes(path, b"two")
    assert path.read_bytes() == b"two"
    assert [each.name for each in path.parent.iterdir()] == ["file.txt"]


def test_a_link_stays_a_link_and_what_it_points_to_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "file", tmp_path / "link"
    real.write_text("old")
    link.symlink_to(real)
    write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["link", "real"]


def test_permissions_of_what_was_there_stay_and_new_files_follow_the_mask(tmp_path):
    path = tmp_path / "file"
    write_text(path, "a")
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    path.chmod(0o640)
    write_text(path, "b")
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("error", "number"),
    [
        (OSError(errno.ENOSPC, "full"), errno.ENOSPC),
        (RuntimeError("unable to write (errno = 28, error message = 'No space left')"), errno.ENOSPC),
    ],
)
def test_a_full_disk_is_one_line_that_names_the_file_and_what_was_there_stays(tmp_path, error, number):
    path = tmp_path / "file.h5"
    path.write_text("good")

    def fill() -> None:
        with writing(path) as unfinished:
            assert unfinished.suffix == ".h5"
            unfinished.write_text("torn")
            raise error

    with pytest.raises(OSError, match=r"cannot write .*file\.h5: No space left on device") as told:
        fill()
    assert told.value.errno == number
    assert "\n" not in str(told.value)
    assert path.read_text() == "good"
    assert [each.name for each in tmp_path.iterdir()] == ["file.h5"]


def test_a_folder_that_is_none_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot write"):
        write_text(tmp_path / "file" / "below", "x")


def test_other_errors_pass_as_they_are(tmp_path):
    def fail() -> None:
        with writing(tmp_path / "file"):
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        fail()
    assert not list(tmp_path.iterdir())


def test_an_output_may_not_be_an_input_under_any_name(tmp_path):
    (tmp_path / "in").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "in")
    os.link(tmp_path / "in", tmp_path / "hard")
    for name in ("in", "link", "hard", "./in"):
        with pytest.raises(ValueError, match="is what is read"):
            check_output(tmp_path / name, inputs=[tmp_path / "other", tmp_path / "in"], overwrite=True)
    with pytest.raises(ValueError, match="is what is read"):
        check_output(Path("not-there"), inputs=["./not-there"])


def test_what_is_there_is_replaced_only_when_told(tmp_path):
    (tmp_path / "there").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").write_text("")
    check_output(tmp_path / "new")
    check_output(tmp_path / "empty")
    for name in ("there", "full"):
        with pytest.raises(FileExistsError, match="--overwrite"):
            check_output(tmp_path / name)
        check_output(tmp_path / name, overwrite=True)


def test_a_place_of_the_caller_s_own_for_what_is_unfinished(tmp_path):
    own, path = tmp_path / "own.unfinished", tmp_path / "new" / "file"
    with writing(path, own) as unfinished:
        assert unfinished == own
        assert not own.exists()
        own.write_text("whole")
    assert path.read_text() == "whole"
    assert not own.exists()


def test_room_is_reserved_or_refused(tmp_path):
    path = tmp_path / "file"
    reserve(path, 100_000)
    assert path.read_bytes() == b""
    with pytest.raises(OSError, match=r"."):
        reserve(path, 1 << 62)
    assert path.read_bytes() == b""


def test_files_written_together_are_all_there_or_none(tmp_path):
    def write(folder, error=None):
        with writing_together(folder) as unfinished:
            for name in ("a", "b"):
                write_text(unfinished / name, "new")
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
