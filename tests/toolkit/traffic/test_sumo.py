from dataclasses import replace
from importlib.util import find_spec

import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.traffic.snapshots import simulate

pytestmark = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")

BODIES = catalogue()


def test_one_simulation_at_a_time_of_sound_networks(site):
    first = simulate(site, BODIES, frames=3, seed=1)
    next(first)
    with pytest.raises(RuntimeError, match="one is open"):
        next(simulate(site, BODIES, frames=3, seed=1))
    assert len(list(first)) == 2
    abandoned = simulate(site, BODIES, frames=3, seed=1)
    next(abandoned)
    abandoned.close()
    assert len(list(simulate(site, BODIES, frames=1, seed=1))) == 1
    broken = site.network.replace('from="junction"', 'from="nowhere"', 1)
    assert broken != site.network
    with pytest.raises(ValueError, match=r"SUMO refuses .*nowhere"):
        next(simulate(replace(site, network=broken), BODIES, frames=1, seed=0))
    assert next(simulate(site, BODIES, frames=1, seed=0)), "and SUMO runs again afterwards"


def test_silent(site, capfd):
    list(simulate(site, BODIES, frames=3, seed=1))
    assert capfd.readouterr() == ("", "")


def test_missing_sumo_is_named(site, without_packages):
    without_packages("libsumo")
    with pytest.raises(ImportError, match=r'pip install "coview\[sim\]"'):
        next(simulate(site, BODIES, frames=1, seed=0))
