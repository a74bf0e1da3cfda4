import numpy as np
import pytest

from placement_env.analysis.failures import Failures, failures, format_failures


def test_failures_of_a_set():
    share = np.array([0.4, 0.3, 0.2, 0.1])
    chosen = np.array([True, True, False, True])
    one = failures(lambda sets: sets @ share, chosen)
    assert one.intact == pytest.approx(0.8)
    assert one.lost.tolist() == [[0], [1], [3]]
    assert one.left == pytest.approx([0.4, 0.5, 0.7])
    assert one.mean == pytest.approx(1.6 / 3)
    assert one.worst == pytest.approx(0.4)
    assert one.most_missed == (0,)
    two = failures(lambda sets: sets @ share, chosen, failing=2)
    assert two.most_missed == (0, 1)
    assert two.left == pytest.approx([0.1, 0.3, 0.4])


def test_of_equal_failures_the_first_is_named():
    assert Failures(1.0, np.array([[2], [5]]), np.array([0.5, 0.5])).most_missed == (2,)


@pytest.mark.parametrize("failing", [0, 3])
def test_failures_refuse(failing):
    with pytest.raises(ValueError, match=f"all 2 sensors of the set can fail, got failing={failing}"):
        failures(lambda sets: np.zeros(len(sets)), np.array([True, True, False]), failing=failing)


def test_table():
    share = np.array([0.4, 0.2, 0.0, 0.1])
    cases = [failures(lambda sets: sets @ share, np.ones(4, bool), failing=k) for k in (1, 2)]
    *_, two = format_failures(cases, ["north", "south", "east", "west"]).splitlines()
    assert two.split() == ["N-2", "0.7000", "0.3500", "0.1000", "north,", "south"]
