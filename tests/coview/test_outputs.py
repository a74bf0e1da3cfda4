"""Where a command may write."""

import pytest

from coview.outputs import check_file, check_folder


def test_what_may_be_written_and_what_may_not(tmp_path):
    check_file(None)
    check_file(tmp_path / "new" / "folder" / "file.ply")
    check_folder(tmp_path / "new", holds="table.json")
    (tmp_path / "other").write_text("")
    check_folder(tmp_path, holds="table.json")  # other files in it do not matter
    check_file(tmp_path / "other", overwrite=True)
    assert [each.name for each in tmp_path.iterdir()] == ["other"]
    (tmp_path / "there").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    for out in (tmp_path / "there", tmp_path / "link"):
        with pytest.raises(FileExistsError, match="--overwrite"):
            check_file(out)
        with pytest.raises(ValueError, match="is what is read"):
            check_file(out, inputs=[tmp_path / "there"], overwrite=True)
    with pytest.raises(NotADirectoryError, match="give another path"):
        check_file(tmp_path / "there" / "below", overwrite=True)
    with pytest.raises(IsADirectoryError, match="is a folder"):
        check_file(tmp_path, overwrite=True)
    with pytest.raises(FileExistsError):
        check_folder(tmp_path, holds="there")


def test_folders_that_may_not_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr("coview.outputs.os.access", lambda *_: False)
    with pytest.raises(PermissionError, match="may not be written"):
        check_file(tmp_path / "file")
