"""What the argument parser refuses comes in one line, with what was typed and what helps."""

import pytest


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("evaluat", "unknown command 'evaluat': did you mean evaluate?"),
        ("frobnicate", "unknown command 'frobnicate': choose among demo, site, simulate"),
        ("evaluate", "evaluate needs dataset: recording made by coview simulate"),
        (
            "evaluate x.hdf5 --classes car",
            "--classes: there is no class 'car', it counts as vehicle: choose among",
        ),
        (
            "evaluate x.hdf5 --classes bicicle",
            "--classes: there is no class 'bicicle', it counts as cyclist",
        ),
        (
            "evaluate x.hdf5 --classes Vehicles",
            "--classes: there is no class 'Vehicles', but vehicle",
        ),
        (
            "evaluate x.hdf5 --classes tree",
            "--classes: there is no class 'tree': choose among vehicle",
        ),
        ("evaluate x.hdf5 --metric 4d", "--metric must be one of 3d, bev, got '4d'"),
        (
            "evaluate x.hdf5 --area 1 2 3",
            "--area takes 4 numbers, got 1 2 3: area xmin ymin xmax ymax",
        ),
        ("evaluate x.hdf5 --area 1 2 3 b", "--area takes 4 numbers, got 1 2 3 b"),
        ("evaluate x.hdf5 --json yes", "unexpected argument 'yes': see coview evaluate --help"),
        ("plan tjunction --bugdet 3", "plan has no option --bugdet: did you mean --budget?"),
        ("plan tjunction --zzz 3", "plan has no option --zzz: see coview plan --help"),
        ("plan tjunction --frames abc", "--frames takes a whole number, got abc: number of frames"),
        ("plan tjunction --frames", "--frames needs a whole number"),
        ("live --port x", "--port takes a whole number, got x"),
        ("site", "site needs one of import, random, show, export"),
        ("site shwo", "unknown command site shwo: did you mean show?"),
        ("site show", "site show needs site: tjunction, roundabout, or a site file"),
        (
            "train --device cpu",
            "train needs --data: packed file made by coview pack; --out: folder for checkpoint",
        ),
    ],
)
def test_a_line_that_cannot_be_parsed_is_refused_in_one(line, said, refused):
    assert said in refused(*line.split())
