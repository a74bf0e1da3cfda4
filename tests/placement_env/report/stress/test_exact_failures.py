"""N-1 and N-2 from tables."""

import numpy as np
import pytest

from placement_env.fidelity.table import load_table
from placement_env.report.stress.exact_failures import exact_failures


def test_the_shipped_table_says_what_is_left():
    table = load_table("tjunction")
    found = {(each.scheme, each.iou, each.failing): each for each in exact_failures(table, ious=(0.7, 0.9))}
    assert len(found) == 3 * 2 * 2
    early = table.ap[:, 0, 0]
    one = found["early", 0.7, 1]
    left = [early[0b111111 ^ (1 << k)] for k in range(6)]
    assert one.intact == early[-1]
    assert one.worst == min(left)
    assert one.mean == pytest.approx(np.mean(left))
    assert one.without == (table.origin.sensors[int(np.argmin(left))],)
    two = found["late", 0.9, 2]
    pairs = [table.ap[0b111111 ^ (1 << a) ^ (1 << b), 1, 2] for a in range(6) for b in range(a)]
    assert two.worst == min(pairs)
    assert len(two.without) == 2
    assert two.as_dict()["failing"] == 2


def test_what_a_table_does_not_hold():
    table = load_table("tjunction")
    assert {each.iou for each in exact_failures(table, ious=(0.5, 0.8))} == {0.8}
    with pytest.raises(ValueError, match=r"holds AP at IoU 0\.7, 0\.8, 0\.9, none of 0\.5"):
        exact_failures(table, ious=(0.5,))
    with pytest.raises(ValueError, match=r"holds AP at IoU 0\.5, none of 0\.7"):
        exact_failures(table, label="cyclist", ious=(0.7,))
    with pytest.raises(ValueError, match="holds vehicle, cyclist, pedestrian, heavy, not tram"):
        exact_failures(table, label="tram")
