"""The searches by name."""

from importlib.util import find_spec

import pytest

from placement_env.candidates.pool import paper_candidates
from placement_env.fidelity.preparation import check_scorable
from placement_env.search.methods import METHODS, check_search, load_search, usual_method
from placement_env.setting import Setting
from toolkit.sites.files import load_site

SITE = load_site("tjunction")


@pytest.mark.parametrize("name", METHODS)
def test_every_name_is_a_search(name):
    if METHODS[name].needs and not find_spec(METHODS[name].needs):
        pytest.skip("its package is missing")
    assert callable(load_search(name))
    check_search(name, "detector", paper_candidates(SITE))


def test_unknown_and_usual_methods():
    with pytest.raises(ValueError, match="method must be one of portfolio, exhaustive, greedy"):
        check_search("luck", "coverage", paper_candidates(SITE))
    assert [usual_method(each) for each in ("coverage", "surrogate", "detector", "table")] == [
        "portfolio", "portfolio", "greedy", "exhaustive"
    ]  # fmt: skip
    assert usual_method("surrogate", verify=True) == "greedy"
    assert usual_method("table", at_least=True) == "cheapest"


@pytest.mark.parametrize("fidelity", ["coverage", "surrogate", "detector", "table"])
def test_what_can_be_scored_is_not_refused(fidelity):
    check_scorable(Setting(SITE, fidelity=fidelity))
