"""Tables of measured figures: written by benchmarks, never by hand."""

import json

import pytest

from tests.benchmarks import figures

PAGE = "# Figures\n\nIntro.\n\n<!-- table speed -->\nstale\n<!-- end -->\n\nOutro.\n"
ROW = {
    "cells": ["iou", "2 ms"],
    "network": "–",
    "date": "1 Jan 2026",
    "commit": "abc",
    "machine": "B",
}


@pytest.fixture
def documents(tmp_path, monkeypatch):
    """Folder with a page and a table of its own."""
    monkeypatch.setattr(figures, "FIGURES", tmp_path / "figures.json")
    monkeypatch.setattr(figures, "PAGE", tmp_path / "figures.md")
    (tmp_path / "figures.md").write_text(PAGE, encoding="utf-8")
    tables = {"speed": {"columns": ["what", "result"], "rows": [ROW]}}
    (tmp_path / "figures.json").write_text(json.dumps(tables), encoding="utf-8")
    return tmp_path


def test_the_page_shows_what_benchmarks_wrote():
    page = figures.PAGE.read_text(encoding="utf-8")
    assert figures.render_page(page, figures.read_tables()) == page


def test_rows_of_a_table_have_one_cell_a_column_and_names_of_their_own():
    for name, table in figures.read_tables().items():
        names = [row["cells"][0] for row in table["rows"]]
        assert len(set(names)) == len(names), name
        assert {len(row["cells"]) for row in table["rows"]} == {len(table["columns"])}, name


def test_what_all_rows_share_is_written_below_the_table():
    text = figures.render_page(PAGE, {"speed": {"columns": ["what", "result"], "rows": [ROW]}})
    assert "| iou | 2 ms |\n\nMeasured 1 Jan 2026, abc, B.\n" in text
    assert "stale" not in text
    assert text.startswith("# Figures\n\nIntro.\n")
    assert text.endswith("Outro.\n")


def test_what_rows_do_not_share_gets_a_column():
    other = {**ROW, "cells": ["nms", "3 ms"], "network": "`site`", "date": "2 Jan 2026"}
    lines = figures.render_table({"columns": ["what", "result"], "rows": [ROW, other]})
    assert lines[1] == "| what | result | network | measured |"
    assert lines[4] == "| nms | 3 ms | `site` | 2 Jan 2026, abc, B |"


def test_nothing_is_kept_without_the_name_of_the_machine(documents, environment):
    environment(COVIEW_FIGURES=None)
    figures.record("speed", "iou", ["1 ms"])
    assert figures.read_tables()["speed"]["rows"] == [ROW]


def test_a_measured_row_replaces_the_row_of_its_name(documents, environment):
    environment(COVIEW_FIGURES="Q")
    figures.record("speed", "iou", ["1 ms"])
    figures.record("speed", "nms", ["4 ms"])
    commit = figures.current_commit()
    first, second = figures.read_tables()["speed"]["rows"]
    assert (first["cells"], first["machine"], first["commit"]) == (["iou", "1 ms"], "Q", commit)
    assert second["cells"] == ["nms", "4 ms"]
    assert "| nms | 4 ms |" in (documents / "figures.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("table", "cells", "error", "words"),
    [
        ("sped", ["1 ms"], KeyError, "no table 'sped'"),
        ("speed", ["1 ms", "2 ms"], ValueError, "has 2 columns"),
    ],
)
def test_a_row_that_fits_no_table_is_refused(documents, environment, table, cells, error, words):
    environment(COVIEW_FIGURES="B")
    with pytest.raises(error, match=words):
        figures.record(table, "iou", cells)


def test_page_and_tables_must_name_the_same_ones():
    with pytest.raises(ValueError, match="does not show hidden"):
        figures.render_page("", {"hidden": {"columns": [], "rows": []}})
    with pytest.raises(ValueError, match="'speed' that was not measured"):
        figures.render_page(PAGE, {})


def test_results_of_evaluate_become_rows_of_schemes(documents, environment):
    environment(COVIEW_FIGURES="B")
    tables = {"schemes": {"columns": ["site, scheme", "AP", "kbit"], "rows": []}}
    figures.FIGURES.write_text(json.dumps(tables), encoding="utf-8")
    figures.PAGE.write_text("<!-- table schemes -->\n<!-- end -->\n", encoding="utf-8")
    rows = [
        {"scheme": "early", "label": label, "iou": iou, "ap": ap, "kbit_per_sensor": 520.0}
        for label, iou, ap in [("vehicle", 0.7, 0.9), ("vehicle", 0.8, 0.8), ("cyclist", 0.5, 0.1)]
    ]
    figures.record_result("T-junction", {"rows": rows}, "`site`")
    (row,) = figures.read_tables()["schemes"]["rows"]
    assert row["cells"] == ["T-junction, early", "0.9000/0.8000", "520.00"]
    assert row["network"] == "`site`"


def test_results_of_stress_stand_next_to_those_with_tracks(documents, environment):
    environment(COVIEW_FIGURES="B")
    tables = {"late-messages": {"columns": ["", "as they arrive", "with tracks"], "rows": []}}
    figures.FIGURES.write_text(json.dumps(tables), encoding="utf-8")
    figures.PAGE.write_text("<!-- table late-messages -->\n<!-- end -->\n", encoding="utf-8")
    rows = [
        {
            "label": "vehicle",
            "kind": kind,
            "level": level,
            "judged": {"ap": ap, "low": low, "high": 1},
        }
        for kind, level, ap, low in [
            ("delay", "0.1 s", 0.9, 0.8),
            ("delay", "0.1 s, tracks", 0.95, 0.9),
            ("loss", "30%", 0.97, 0.93),
            ("loss", "30%, tracks", 0.99, None),
        ]
    ]
    figures.record_result("T-junction", {"rows": rows}, "`site`")
    cells = [row["cells"] for row in figures.read_tables()["late-messages"]["rows"]]
    assert cells == [
        ["delay 0.1 s", "0.900 (0.800–1.000)", "0.950 (0.900–1.000)"],
        ["loss 30%", "0.970 (0.930–1.000)", "0.990"],
    ]


def test_results_of_other_commands_are_refused():
    with pytest.raises(ValueError, match="neither vehicles by scheme"):
        figures.record_result("T-junction", {"sensors": []}, "–")
