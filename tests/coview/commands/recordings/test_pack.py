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
    assert "--frames must be at least 1" in refused("pack", recording, "--frames", 0, "--out", tmp_path / "x")
    assert "give recordings" in refused("pack", "--out", tmp_path / "x")
