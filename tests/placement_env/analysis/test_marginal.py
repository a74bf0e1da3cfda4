import numpy as np
import pytest

from placement_env.analysis.marginal import format_marginal, marginal
from placement_env.protocol import Estimate


class Linear:
    """Each sensor adds its own AP and kbit."""

    name = "coverage"

    def __call__(self, sets):
        ap = sets @ np.array([0.4, 0.2, 0.0, 0.1])
        return Estimate(ap, ap, sets @ np.array([100.0, 10.0, 5.0, 0.0]))


@pytest.mark.parametrize("chosen", [[False] * 4, [True] * 4, [True, False, True, False]])
def test_marginal_gains_in_and_out_of_the_set(chosen):
    gains = marginal(Linear(), np.array(chosen))
    assert gains.gain == pytest.approx([0.4, 0.2, 0.0, 0.1])
    assert gains.kbit == pytest.approx([100, 10, 5, 0])
    assert gains.per_kbit[:3] == pytest.approx([0.004, 0.02, 0.0], abs=1e-12)
    assert gains.per_kbit[3] == np.inf


def test_table():
    names = ["north", "south", "east", "west"]
    _, free, south, *_ = format_marginal(marginal(Linear(), np.ones(4, bool)), names).splitlines()
    assert free.split() == ["west", "+0.1000", "0.00", "+inf"]
    assert south.split() == ["south", "+0.2000", "10.00", "+20.0000"]
