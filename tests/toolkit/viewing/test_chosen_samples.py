import pytest

from toolkit.datasets.records.fields import Listing
from toolkit.datasets.sample import Sample
from toolkit.objects import Objects
from toolkit.viewing.chosen_samples import ChosenSamples


def sample(name):
    return Sample(str(name), (), Objects.empty())


class Forward:
    """Samples that are read from the beginning, as a bag's; it counts what is read."""

    def __init__(self, count, promised=None):
        self.count, self.promised, self.read = count, promised or count, 0

    def __len__(self):
        return self.promised

    def __iter__(self):
        for number in range(self.count):
            self.read += 1
            yield sample(number)


def names(samples):
    return [each.name for each in samples]


@pytest.mark.parametrize("samples", [Forward(7), Listing(tuple("0123456"), sample)], ids=["forward", "listing"])
def test_every_so_many_and_the_first_of_these(samples):
    assert names(ChosenSamples(samples)) == list("0123456")
    assert names(ChosenSamples(samples, every=3)) == ["0", "3", "6"]
    assert names(ChosenSamples(samples, frames=2, every=3)) == ["0", "3"]
    assert names(ChosenSamples(samples, frames=99, every=5)) == ["0", "5"]
    chosen = ChosenSamples(samples, every=2)
    assert len(chosen) == 4
    assert [chosen.at(k).name for k in (3, 0, 1, 1, 2)] == ["6", "0", "2", "2", "4"]


def test_going_on_reads_nothing_twice():
    samples = Forward(7)
    chosen = ChosenSamples(samples, every=2)
    for number in range(4):
        chosen.at(number)
    assert samples.read == 7
    chosen.at(0)
    assert samples.read == 8


def test_a_recording_that_ends_early_says_so_and_can_be_read_again():
    chosen = ChosenSamples(Forward(2, promised=5))
    with pytest.raises(ValueError, match="ends before its sample 4"):
        chosen.at(4)
    assert chosen.at(1).name == "1"


def test_what_is_refused():
    with pytest.raises(ValueError, match="every must be at least 1, got 0"):
        ChosenSamples(Forward(3), every=0)
    with pytest.raises(ValueError, match="frames must be at least 1, got 0"):
        ChosenSamples(Forward(3), frames=0)
    with pytest.raises(ValueError, match="no sample to view"):
        ChosenSamples(Listing((), sample))
    for number in (-1, 3):
        with pytest.raises(ValueError, match="3 are chosen"):
            ChosenSamples(Forward(3)).at(number)
