"""Time until a fault is noticed, on flat ground with a moving block."""

import pytest

from examples.studies.stress.noticing import Noticed, time_faults
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor


@pytest.fixture(scope="module")
def found(driving, tops):
    fine = driving(30)  # in images nine times as fine
    fine.sensors = tuple(
        Sensor(s.name, DepthCamera(width=135, height=90, stride=1), s.pose) for s in driving.sensors
    )
    return time_faults(fine, tops(), Run(frames=28))


def test_faults_are_noticed_both_ways(found):
    noticed = {(each.fault, each.sent_as): each for each in found[0]}
    assert {each.cases for each in noticed.values()} == {2}
    for way in ("whole images", "foreground"):
        assert noticed["silent", way].median == noticed["silent", way].worst == pytest.approx(0.5)
    assert noticed["frozen", "whole images"] == Noticed("frozen", "whole images", 2, 2, 0.2, 0.2)
    assert noticed["blinded", "whole images"] == Noticed("blinded", "whole images", 2, 2, 0.2, 0.2)
    assert noticed["frozen", "foreground"].worst == 0.2
    assert noticed["blinded", "foreground"].worst == 0.2


def test_false_alarms_are_of_losses(found):
    alarms = {(each.link, each.sent_as): each for each in found[1]}
    nothing = alarms["nothing wrong", "foreground"]
    assert nothing.alarms == 0
    assert nothing.minutes == pytest.approx(0.09)
    assert alarms["delay 0.3 s", "whole images"].alarms == 0
    assert (
        alarms["loss 30% in bursts of 5", "whole images"].alarms
        == alarms["loss 30% in bursts of 5", "foreground"].alarms
    )
    assert len(alarms) == 14


def test_few_pixels_and_short_traffic_tell_nothing(driving, tops):
    noticed = {(each.fault, each.sent_as): each for each in time_faults(driving(28), tops())[0]}
    assert noticed["frozen", "whole images"].noticed == 2
    assert (noticed["frozen", "foreground"].noticed, noticed["frozen", "foreground"].worst) == (
        0,
        float("inf"),
    )
    with pytest.raises(ValueError, match="no stretch of traffic is 2 s long"):
        time_faults(driving(10), tops())
