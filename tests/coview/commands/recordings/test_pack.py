"""coview pack: no recording is lost."""

import json


def test_it_packs_and_replaces_nothing_untold(recording, tmp_path, run, refused):
    out = tmp_path / "few.packed"
    code, printed, _ = run("pack", recording, "--frames", 2, "--out", out, "--json")
    assert (code, json.loads(printed)["frames"]) == (0, 2)
    before = recording.read_bytes()
    assert "is what is read" in refused("pack", recording, "--out", recording, "--overwrite")
    assert "--overwrite" in refused("pack", recording, "--out", out)
    assert recording.read_bytes() == before
    assert "frames must be a whole number of at least 1" in refused(
        "pack", recording, "--frames", 0, "--out", tmp_path / "x"
    )
    assert "give recordings" in refused("pack", "--out", tmp_path / "x")


def test_plain_clouds_are_packed_with_simulated_frames(recording, tmp_path, run, refused):
    from models.config import VoxelNetConfig
    from models.training.packed import PackedFrames
    from models.training.samples import SampleRecipe, Samples

    assert run("pack", recording, "--frames", 2, "--out", tmp_path / "s.packed")[0] == 0
    arguments = ("pack", recording, "--layout", "hdf5", "--frames", 1, "--level", "plane")
    area = ("--area", -40, -20, 40, 20)
    code, out, _ = run(
        *arguments, *area, "--packed", tmp_path / "s.packed", "--out", tmp_path / "m.packed"
    )
    assert code == 0
    assert "3 frames" in out
    mixed = PackedFrames(tmp_path / "m.packed")
    assert [mixed.is_recorded(k) for k in range(3)] == [True, False, False]
    joined = (
        "--packed",
        tmp_path / "s.packed",
        tmp_path / "m.packed",
        "--out",
        tmp_path / "both.packed",
    )
    assert "5 frames" in run("pack", *joined)[1]
    assert "not both" in refused("pack", "--random-sites", 2, *joined)
    assert mixed.rig(0).area == (-40, -20, 40, 20)
    simulated, recorded = (sum(map(len, mixed.points(k, None))) for k in (1, 0))
    assert recorded > 0.8 * simulated
    samples = Samples(
        mixed,
        VoxelNetConfig.light((-20, -20, 20, 20)),
        SampleRecipe(subsets=0.0, errors=1.0),
        seed=0,
    )
    for k in range(3):
        assert len(samples[0, k].voxels.points) > 100
