"""The figures that the paper reports."""

import pytest

from examples.studies.paper.paper_rows import set_name
from examples.studies.paper.paper_tables import (
    BENCHMARK_TABLE,
    CURVE_STATEMENTS,
    DENSITY_STATEMENTS,
    PAPER_SITES,
    REGION_TABLE,
    SCHEME_TABLE,
    sensor_sets,
)


def test_schemes_are_the_published_ones():
    for site in PAPER_SITES:
        everyone = sensor_sets(site).rows[0]
        assert SCHEME_TABLE[site]["early"].ap[0] == everyone.early
        assert SCHEME_TABLE[site]["late"].ap[0] == everyone.late
    assert SCHEME_TABLE["tjunction"]["hybrid"] == ((0.8903, 0.7056, 0.07277), 64, 380)
    assert SCHEME_TABLE["roundabout"]["late"] == ((0.8143, 0.5986, 0.01762), 0.26, 214)
    assert [SCHEME_TABLE["roundabout"][s].kbit for s in ("late", "hybrid", "early")] == [
        0.26,
        372,
        674,
    ]
    assert SCHEME_TABLE["tjunction"]["early"].ap == (0.9870, 0.9447, 0.3861)
    assert SCHEME_TABLE["roundabout"]["early"].ap == (0.9670, 0.8816, 0.04638)


def test_sensor_sets_are_the_published_ones():
    junction, roundabout = sensor_sets("tjunction"), sensor_sets("roundabout")
    assert [len(each.rows) for each in (junction, roundabout)] == [16, 22]
    assert list(map(set_name, junction.best["early"])) == [
        "0,1,2,3,4,5",
        "0,1,3,4,5",
        "1,3,4,5",
        "0,2,5",
        "3,4",
        "4",
    ]
    assert list(map(set_name, junction.best["late"])) == [
        "0,1,2,3,4,5",
        "1,2,3,4,5",
        "1,3,4,5",
        "3,4,5",
        "3,4",
        "4",
    ]
    assert roundabout.best["early"][2:6] == (
        (1, 2, 3, 5, 6, 7),
        (1, 2, 3, 5, 7),
        (1, 3, 5, 7),
        (1, 3, 7),
    )
    assert roundabout.best["late"][2] == (0, 1, 2, 3, 5, 7)
    assert roundabout.best["late"][6] == (1, 3)
    for site in PAPER_SITES:
        assert all(row.early == row.late for row in sensor_sets(site).rows if len(row.sensors) == 1)


def test_regions_and_benchmarks_are_the_published_ones():
    ap = {
        (row.region, row.sensors): row.ap
        for row in (*REGION_TABLE["tjunction"], *REGION_TABLE["roundabout"])
    }
    assert [ap[(1, 5), each] for each in ((1,), (5,), (1, 5))] == [0.4717, 0.3222, 0.8722]
    assert [ap[(2, 4), each] for each in ((2,), (4,), (2, 4))] == [0.5621, 0.7942, 0.9560]
    assert [ap[(1, 7), each] for each in ((1,), (7,), (1, 7))] == [0.1474, 0.8874, 0.8925]
    assert [ap[(3, 5), each] for each in ((3,), (5,), (3, 5))] == [0.3944, 0.8819, 0.8996]
    assert [row.two for row in BENCHMARK_TABLE] == [None, 0.7237, 0.7237, ap[(1, 5), (1, 5)]]
    assert BENCHMARK_TABLE[-1].single == (ap[(1, 5), (1,)],)
    assert BENCHMARK_TABLE[0].single == (0.8197, 0.6546, 0.6285)


def test_statements_are_about_the_best_sets():
    for site in PAPER_SITES:
        for says in (*CURVE_STATEMENTS[site], *DENSITY_STATEMENTS[site]):
            assert says.sensors in sensor_sets(site).best["early"]
            assert 0 <= says.value <= 1


@pytest.mark.parametrize("site", PAPER_SITES)
def test_sets_are_ascending_and_listed_best_first(site):
    rows = sensor_sets(site).rows
    assert all(list(row.sensors) == sorted(set(row.sensors)) for row in rows)
    for size in range(1, 9):
        early = [row.early for row in rows if len(row.sensors) == size]
        assert early == sorted(early, reverse=True)
