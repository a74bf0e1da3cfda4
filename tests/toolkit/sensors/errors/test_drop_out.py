from dataclasses import replace

import numpy as np
import pytest

from toolkit.sensors.errors.drop_out import DeadRows, DropOut, chance_of_return


def test_the_law_of_range_incidence_and_reflectivity():
    """p = 1/2 where rho · cos · (half / R)² = 1; twice the range or a quarter of the power is the same."""
    one = np.ones(1)
    assert chance_of_return(80 * one, one, 80.0, 2.0)[0] == 0.5
    assert chance_of_return(40 * one, 0.25 * one, 80.0, 3.0)[0] == pytest.approx(0.5)
    assert chance_of_return(40 * one, one, 80.0, 3.0, 0.25)[0] == pytest.approx(0.5)
    assert chance_of_return(160 * one, one, 80.0, 2.0)[0] == pytest.approx(1 / 17)
    falling = chance_of_return(np.linspace(1, 300, 50), np.full(50, 0.7), 100.0, 2.0)
    assert (np.diff(falling) < 0).all()
    assert falling[0] > 0.9999
    assert falling[-1] < 0.02
    assert chance_of_return(one, 0 * one, 80.0, 2.0)[0] < 1e-6


@pytest.mark.parametrize("share", [0.02, 0.4])
def test_the_share_that_drops_out(read, wall, sensor, share):
    said = read(DropOut(share), wall(sensor, 30.0))
    assert 1 - said.valid.mean() == pytest.approx(share, rel=0.12)
    assert set(np.unique(said.measurement)) == {0.0, 30.0}


def test_range_and_incidence_take_more(read, street):
    term = DropOut(half_range=25.0)
    lost = np.mean([~read(term, street, frame=f).valid[street.valid] for f in range(12)], axis=0)
    expected = 1 - chance_of_return(street.ranges, street.cosines, 25.0, 2.0)[street.valid]
    for low, high in ((0, 0.2), (0.2, 0.6), (0.6, 0.9), (0.9, 1)):
        some = (expected >= low) & (expected < high)
        assert some.sum() > 100
        assert lost[some].mean() == pytest.approx(expected[some].mean(), abs=0.02)


def test_shares_multiply(read, wall, sensor):
    truth = wall(sensor, 50.0)
    kept = read(DropOut(0.5, half_range=50.0), truth).valid.mean()
    assert kept == pytest.approx(0.5 * chance_of_return(truth.ranges, truth.cosines, 50.0, 2.0).mean(), rel=0.06)


def test_dead_rows_are_whole_rows_and_stay_dead(read, wall, sensor):
    truth = wall(sensor, 10.0)
    said = [read(DeadRows(0.25), truth, frame=frame).valid for frame in (0, 1, 77)]
    assert all(np.array_equal(each, said[0]) for each in said)
    whole = said[0].all(axis=1)
    assert np.array_equal(~whole, ~said[0].any(axis=1))
    shares = [read(DeadRows(0.25), truth, number=n).valid.mean() for n in range(300)]
    assert np.mean(shares) == pytest.approx(0.75, abs=0.01)
    assert len(set(shares)) > 5
    assert not read(DeadRows(1.0), truth).valid.any()


def test_no_strength_no_change(harmless, street):
    harmless(DropOut(), street)
    harmless(DeadRows(), street)


def test_all_of_nothing(read, street):
    nothing = replace(street, measurement=np.zeros_like(street.measurement))
    assert not read(DropOut(0.5, 40.0), nothing).measurement.any()


def test_wrong_numbers():
    for wrong in (lambda: DropOut(-0.1), lambda: DropOut(half_range=-1.0), lambda: DeadRows(1.1)):
        with pytest.raises(ValueError, match="must be a"):
            wrong()
