"""Names with separators in the mounting schedule (RFC 4180): other readers give them back whole."""

import csv
import io

import pytest

from placement_env.handover.exchange import schedule_csv
from placement_env.handover.mounted import PlannedSensor

NAMES = [
    "Straße;5",
    "a,b",
    'the "old" pole',
    "tab\there",
    "two\nlines",
    "信号灯杆一",
    "عمود",
    "Ώμος",
    " ends ",
]


def planned(name: str) -> PlannedSensor:
    return PlannedSensor(
        name=f"{name}/1",
        pole=name,
        x=1.0,
        y=2.0,
        z=5.0,
        longitude=8.0,
        latitude=49.5,
        height=5.0,
        bearing_deg=90.0,
        tilt_deg=20.0,
        model="depth camera",
        model_price=0.5,
        pole_price=1.0,
        kbit=310.0,
        peak_kbit=402.0,
        capacity_kbit=2000.0,
        load_kbit=390.0,
    )


def test_names_come_back_whole():
    text = schedule_csv([planned(name) for name in NAMES])
    head, *rows = csv.reader(io.StringIO(text.encode().decode("utf-8"), newline=""), strict=True)
    assert [row[head.index("pole")] for row in rows] == NAMES
    assert {len(row) for row in rows} == {len(head)}


def test_pandas_reads_the_same_names():
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(io.BytesIO(schedule_csv([planned(name) for name in NAMES]).encode()))
    assert table["pole"].tolist() == NAMES


def test_a_name_is_never_a_formula():
    """Spreadsheets run what begins with =, +, - or @ (OWASP, CSV injection), also after a separator
    of theirs."""
    for name in ("=1+1", "@x", "+5", "a;=1+1", "a\t=1"):
        _, row = csv.reader(io.StringIO(schedule_csv([planned(name)]), newline=""))
        for cell in row[0].replace("\t", ";").split(";"):
            assert not cell.startswith(("=", "@", "+")), row[0]
