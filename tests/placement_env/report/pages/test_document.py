import pytest

from placement_env.report.pages.document import Cell, Column, TableBlock, table


def test_a_heading_says_the_unit():
    assert [Column("price", "EUR").heading, Column("AP").heading] == ["price (EUR)", "AP"]


def test_every_row_has_a_cell_for_each_column():
    with pytest.raises(ValueError, match=r"'Links' has 2 columns, got a row of 1 cells"):
        TableBlock("Links", (Column("a"), Column("b")), ((Cell("x"),),))


def test_a_table_without_rows_is_left_out():
    assert table("Links", [Column("Pole")], []) == ()
    (only,) = table("Links", [Column("Pole")], [[Cell("p")]])
    assert only.rows == ((Cell("p"),),)
