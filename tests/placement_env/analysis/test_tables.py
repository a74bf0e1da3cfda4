from placement_env.analysis.tables import columns


def test_cells_are_aligned_and_no_line_ends_in_blanks():
    lines = columns([["sensor", "AP", ""], ["n", "0.25", "x"]]).splitlines()
    assert lines == ["sensor    AP", "n       0.25  x"]
