"""coview demo: twice is as good as once, and nobody's files are lost."""

import pytest

from coview.options import Output


@pytest.mark.slow
def test_twice_and_never_over_other_files(run, refused, tmp_path):
    out = tmp_path / "demo"
    arguments = ("demo", "--frames", 2, "--detector", "cluster", "--plan-frames", 0, "--out", out)
    for frames in (2, 2, 1):
        assert run(*arguments[:2], frames, *arguments[3:])[0] == 0
        assert {"birds_eye.png", "pr_0.7.png", "table.json", "tjunction.hdf5"} <= {
            each.name for each in out.iterdir()
        }
    (out / "mine.txt").write_text("precious")
    assert "--overwrite" in refused(*arguments)


def test_it_ends_with_a_plan_of_the_site_s_own_sensors(run, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "coview.commands.placement.demo.plan_command",
        lambda *site, **question: asked.append((site, question)),
    )
    out = tmp_path / "demo"
    code, printed, _ = run(
        "demo",
        "--frames",
        1,
        "--detector",
        "cluster",
        "--plan-frames",
        5,
        "--seed",
        3,
        "--out",
        out,
    )
    ((site, question),) = asked
    assert (code, site) == (0, ("tjunction",))
    assert (question["goal"].budget, question["stock"].candidates) == (3, "paper")
    assert (question["run"].seed, question["run"].frames, question["run"].cache) == (
        3,
        5,
        out / "cache",
    )
    assert question["output"] == Output(out=out / "plan", overwrite=True)
    assert f"open {out / 'plan' / 'report.html'} in a browser" in printed
