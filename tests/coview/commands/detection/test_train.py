"""coview train: the same run goes on, another one replaces it only when told."""

import json

import pytest

from models.weight_files import digest_tensors, load_weights
from toolkit.runtime.resumable import ShardFolder


@pytest.fixture(scope="module")
def packed(recording, tmp_path_factory):
    from coview.main import run

    out = tmp_path_factory.mktemp("packed") / "few.packed"
    assert run(["pack", str(recording), "--out", str(out)]) == 0
    return out


def digest(weights):
    return digest_tensors(load_weights(weights)[0].state_dict())


def test_the_same_goes_on_and_another_is_refused(packed, tmp_path, run, refused):
    out = tmp_path / "run"
    arguments = (
        "train",
        "--data",
        packed,
        "--epochs",
        1,
        "--batch",
        2,
        "--device",
        "cpu",
        "--out",
        out,
    )
    code, printed, err = run(*arguments, "--json")
    assert code == 0, err
    weights = out / "weights.safetensors"
    assert json.loads(printed) == {"weights": str(weights), "ap": {}}
    before = digest(weights)
    with ShardFolder(out, {}).lock():
        assert "another run is writing to" in refused(*arguments)
    assert run(*arguments)[0] == 0
    assert "--overwrite" in refused(*arguments, "--seed", 1)
    assert digest(weights) == before
    assert run(*arguments, "--seed", 1, "--overwrite")[0] == 0
    assert digest(weights) != before
    (out / "checkpoint.pt").unlink()
    assert "--overwrite" in refused(*arguments, "--seed", 1)
    assert "is what is read" in refused(*arguments, "--start", weights, "--overwrite")


@pytest.mark.parametrize("wrong", [("--epochs", 0), ("--batch", 0), ("--seed", -1)])
def test_what_cannot_be_is_refused(wrong, packed, tmp_path, run):
    code, _, err = run("train", "general", "--data", packed, "--out", tmp_path / "run", *wrong)
    assert (code, wrong[0] in err) == (2, True), err
    assert not (tmp_path / "run").exists()
