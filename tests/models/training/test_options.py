"""The one list of training's arguments: the same on both command lines, and on a machine that has
little."""

import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
import tyro

from models.training.options import TrainingOptions, descriptions, parse_arguments

BARE = """
import sys
for name in ("open3d", "libsumo", "sumolib", "gymnasium", "matplotlib", "tyro", "beartype"):
    sys.modules[name] = None
from models.train import train_from_command_line
train_from_command_line(["--help"])
"""

EVERYTHING = (
    "--data d --out o --start general --preset paper --size published --voxel 0.4 --epochs 1.5 "
    "--batch 3 --seed 5 --learning-rate 0.001 --validate v --validate-frames 7 --device cpu "
    "--threads 2 --workers 1 --checkpoint-s 9 --overwrite --classes vehicle pedestrian --faces "
    "vehicle --calibrate"
)


@pytest.mark.parametrize("arguments", [["--data", "d", "--out", "o"], EVERYTHING.split()])
def test_both_command_lines_read_the_same(arguments):
    site, options = parse_arguments(["tjunction", *arguments])
    assert site == "tjunction"
    assert options == tyro.cli(TrainingOptions, args=arguments)


def test_arguments_are_described_and_run_where_there_is_little():
    assert list(descriptions()) == [field.name for field in fields(TrainingOptions)]
    repository = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", BARE], cwd=repository, capture_output=True, text=True, check=True
    )
    assert "--learning-rate" in done.stdout


@pytest.mark.parametrize(
    "wrong", [["--epochs", "0"], ["--batch", "-1"], ["--seed", "-1"], ["--voxel", "nan"]]
)
def test_what_cannot_be_is_refused(wrong, capsys):
    with pytest.raises(SystemExit) as stopped:
        parse_arguments(["--data", "d", "--out", "o", *wrong])
    assert stopped.value.code == 2
    assert wrong[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--classes", "tram"], "classes must be different ones"),
        (["--faces", "heavy"], "--faces must be among --classes vehicle"),
        (["--calibrate"], "--calibrate needs frames"),
    ],
)
def test_classes_that_cannot_be_are_refused(wrong, said, capsys):
    with pytest.raises(SystemExit) as stopped:
        parse_arguments(["--data", "d", "--out", "o", *wrong])
    assert stopped.value.code == 2
    assert said in capsys.readouterr().err
