from pathlib import Path

import numpy as np
import pytest

from toolkit.bodies.mesh_table import NOTHING_SAID, MeshEntry, read_mesh_table
from toolkit.objects import HEAVY


def table(folder: Path, text: str) -> dict[Path, MeshEntry]:
    (folder / "a.obj").touch()
    (folder / "meshes.toml").write_text(text)
    return read_mesh_table(folder)


def test_no_table_says_nothing(tmp_path):
    assert read_mesh_table(tmp_path) == {}
    assert not NOTHING_SAID.framed
    assert np.array_equal(NOTHING_SAID.turn, np.eye(3))


def test_what_an_entry_says(tmp_path):
    text = '[[mesh]]\nfile = "a.obj"\nlabel = "heavy"\nup = "y"\nforward = "-z"\nscale = 0.0254\n'
    (entry,) = table(tmp_path, text).values()
    assert entry == MeshEntry(HEAVY, "y", "-z", 0.0254)
    assert entry.framed
    assert np.allclose(entry.turn @ [1, 2, 3], [-3, -1, 2])  # forward, left, up


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
@pytest.mark.parametrize("forward", ["x", "y", "z", "-x", "-y", "-z"])
def test_every_frame_is_a_rotation(up, forward):
    if up[-1] != forward[-1]:
        turn = MeshEntry(up=up, forward=forward).turn
        assert np.linalg.det(turn) == pytest.approx(1)
        assert np.array_equal(turn @ turn.T, np.eye(3))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[mesh", "is no TOML"),
        ("mesh = 3", r"must hold \[\[mesh\]\] entries alone"),
        ('[other]\nx = 1\n[[mesh]]\nfile = "a.obj"', "entries alone"),
        ("mesh = [1]", "entry 1: file must name a mesh"),
        ('[[mesh]]\nfile = "b.obj"', "file must name a mesh below .*, got 'b.obj'"),
        ('[[mesh]]\nfile = "a.obj"\n[[mesh]]\nfile = "a.obj"', "entry 2: a.obj is there twice"),
        ('[[mesh]]\nfile = "a.obj"\ncolour = 1', "knows file, forward, label, scale, up, got colour"),
        ('[[mesh]]\nfile = "a.obj"\nlabel = "tram"', "entry 1: label must be one of"),
        ('[[mesh]]\nfile = "a.obj"\nlabel = [1]', "entry 1: label must be one of"),
        ('[[mesh]]\nfile = "a.obj"\nup = "north"', "up must be one of x, -x, y, -y, z, -z, got 'north'"),
        ('[[mesh]]\nfile = "a.obj"\nup = [1]', "up must be one of"),
        ('[[mesh]]\nfile = "a.obj"\nup = "x"', "up x and forward x lie on one axis"),
        ('[[mesh]]\nfile = "a.obj"\nscale = 0', "scale must be a number above 0"),
        ('[[mesh]]\nfile = "a.obj"\nscale = nan', "scale must be a number above 0"),
        ('[[mesh]]\nfile = "a.obj"\nscale = true', "scale must be a number above 0"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, text, says):
    with pytest.raises(ValueError, match=says) as error:
        table(tmp_path, text)
    assert "meshes.toml" in str(error.value)
