"""Names of poles beyond Latin in the report: whole, or numbered with a note."""

import re
from dataclasses import replace

import pytest

from placement_env.report.content import Planned, replace_texts
from placement_env.report.pages.report import write_report

NAMES = {"post00": "信号灯杆一", "post01": "Ώμος", "post02": "عمود", "post03": "Straße;5"}


@pytest.fixture
def planned(example, system_fonts) -> Planned:
    """The example with other names of poles, on a computer without fonts of its own."""
    system_fonts()
    plan = replace_texts(
        example.plan, lambda text: re.sub("|".join(NAMES), lambda found: NAMES[found[0]], text)
    )
    (mount, *others) = example.site.mounts
    return replace(
        example,
        plan=plan,
        site=replace(example.site, mounts=(replace(mount, name=NAMES["post00"]), *others)),
        moments=(),
    )


def test_a_pole_whose_name_cannot_be_set_has_a_number(planned, tmp_path):
    with pytest.warns(
        UserWarning,
        match="no font here can set the letters .*'信号灯杆一' is pole 1: install a font",
    ):
        write_report(planned, tmp_path)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert not set(NAMES["post00"]) & set(page)
    for name in ("pole 1", "Ώμος", "عمود", "Straße;5"):
        assert name in page
    assert "pole 1 is U+4FE1 U+53F7 U+706F U+6746 U+4E00" in page
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF-")
