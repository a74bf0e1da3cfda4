"""coview stress: rows, files and what a recording cannot show."""

import json


def test_it_prints_a_table_and_leaves_json_and_svg(recording, tmp_path, run):
    arguments = ("stress", recording, "--frames", 1, "--schemes", "foreground", "--kinds", "bytes", "--out", tmp_path)
    code, out, _ = run(*arguments)
    assert code == 0
    assert out.splitlines()[0].split()[:4] == ["stress", "level", "scheme", "sent"]
    written = json.loads((tmp_path / "stress.json").read_text())
    assert [(row["scheme"], row["codec"]) for row in written["rows"]] == [("foreground", f"{s} cm") for s in (2, 4, 8)]
    assert written["provenance"]["kinds"] == ["bytes"]
    assert (tmp_path / "stress.svg").stat().st_size > 1000
    assert run(*arguments)[0] == 2
    code, out, _ = run(*arguments, "--overwrite", "--json")
    assert json.loads(out) == json.loads((tmp_path / "stress.json").read_text())


def test_wrong_arguments(recording, refused, tmp_path):
    for arguments, said in (
        (("--kinds", "storm"), "choose among bytes, pose, mounting, silent"),
        (("--kinds", "delay"), "needs frames at most 0.5 s apart, these are 5 s"),
        (("--schemes", "middle"), "choose among early"),
        (("--iou", "1.5"), "--iou"),
        (("--frames", "0"), "--frames must be at least 1"),
        (("--seed", "-1"), "--seed"),
    ):
        assert said in refused("stress", recording, *arguments, "--out", tmp_path / "out")
        assert not (tmp_path / "out").exists()
