"""coview demo: twice is as good as once, and nobody's files are lost."""


def test_twice_and_never_over_other_files(run, refused, tmp_path):
    out = tmp_path / "demo"
    arguments = ("demo", "--frames", 2, "--detector", "cluster", "--out", out)
    for frames in (2, 2, 1):
        assert run(*arguments[:2], frames, *arguments[3:])[0] == 0
        assert {"birds_eye.png", "pr_0.7.png", "table.json", "tjunction.hdf5"} <= {each.name for each in out.iterdir()}
    (out / "mine.txt").write_text("precious")
    assert "--overwrite" in refused(*arguments)
