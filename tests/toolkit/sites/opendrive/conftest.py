"""A straight street written by hand: 100 m east from (-50, 0), two lanes, footways, a parking lane on the right."""

from pathlib import Path

import pytest

LANES = (
    '<lanes><laneOffset s="0" a="0.5"/><laneSection s="0"><left><lane id="2" type="sidewalk"><width sOffset="0" a="2"/>'
    '</lane><lane id="1" type="driving"><width sOffset="0" a="3.5"/></lane></left><center><lane id="0" type="none"/>'
    '</center><right><lane id="-1" type="driving"><width sOffset="0" a="3.5"/></lane><lane id="-2" type="parking">'
    '<width sOffset="0" a="2.5"/></lane><lane id="-3" type="sidewalk"><width sOffset="0" a="2"/></lane>'
    '<lane id="-4" type="none"><width sOffset="0" a="0"/></lane></right></laneSection></lanes>'
)


def _street(folder, objects="", signals="", elevation="", lanes=LANES) -> Path:
    road = (
        '<road id="1" length="100" junction="-1"><planView><geometry s="0" x="-50" y="0" hdg="0" length="100"><line/>'
        f"</geometry></planView><elevationProfile>{elevation}</elevationProfile>{lanes}"
        f"<objects>{objects}</objects><signals>{signals}</signals></road>"
    )
    path = folder / "street.xodr"
    path.write_text(f'<OpenDRIVE xmlns="x"><header revMajor="1" revMinor="7"/>{road}</OpenDRIVE>', encoding="utf-8")
    return path


@pytest.fixture
def street():
    return _street
