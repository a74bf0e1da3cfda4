"""Endless output in numbered files, each whole."""

import numpy as np
import pytest

from toolkit.exchange.instant import Instant
from toolkit.exchange.pieces import PieceWriter

BOX = np.array([[10.0, 0, 1, 4, 2, 1.5, 0]])


def instant(time_s):
    return Instant(time_s, BOX, np.array(["vehicle"]), np.array([0.9]), ids=np.array([7]))


def test_a_file_for_every_stretch_of_time(tmp_path):
    writer = PieceWriter({"kitti-tracking": tmp_path / "text"}, piece_s=1.0)
    for k in range(25):
        writer.write(instant(0.1 * k))
    names = sorted(path.name for path in (tmp_path / "text").iterdir() if path.name[0] != ".")
    assert names == ["000000.txt", "000001.txt"]  # the third is not complete yet
    writer.close()
    rows = [len(path.read_text().splitlines()) for path in sorted((tmp_path / "text").iterdir())]
    assert rows == [10, 10, 5]


def test_numbers_go_on_after_a_restart_and_skip_what_a_killed_process_left(tmp_path):
    folder = tmp_path / "text"
    folder.mkdir()
    (folder / "000003.txt").write_text("kept\n")
    (folder / ".000004.txt.0.unfinished.txt").write_text("half\n")
    writer = PieceWriter({"kitti-tracking": folder}, piece_s=1.0)
    writer.write(instant(0.0))
    writer.close()
    assert (folder / "000005.txt").exists()
    assert (folder / "000003.txt").read_text() == "kept\n"
    assert (folder / ".000004.txt.0.unfinished.txt").read_text() == "half\n"


def test_what_cannot_be_written_is_refused_before_the_work(tmp_path):
    with pytest.raises(ValueError, match="no writer 'csv'"):
        PieceWriter({"csv": tmp_path}, piece_s=1.0)
    with pytest.raises(ValueError, match="place on earth"):
        PieceWriter({"mf-json": tmp_path}, piece_s=1.0)
    with pytest.raises(ValueError, match="more than 0 s"):
        PieceWriter({}, piece_s=0.0)
