import json

from placement_env.search.portfolio.proposals import Proposal, Proposals


class Asked:
    """Proposes the first candidates for budgets above 1."""

    name = "somebody"

    def __call__(self, objective, budget):
        return Proposal(tuple(range(budget))) if budget > 1 else Proposal((), "not for one")


def test_nobody_proposes_nothing(street):
    none = Proposals.of(None, street.objective, (1, 2))
    assert (none.name, dict(none.sets), none.notes, none.starts(2)) == ("", {}, (), ())


def test_a_set_for_each_budget_and_each_note_once(street):
    made = Proposals.of(Asked(), street.objective, (1, 2, 3))
    assert made.name == "somebody"
    assert made.sets == {1: (), 2: (0, 1), 3: (0, 1, 2)}
    assert made.notes == ("not for one",)
    assert (made.starts(1), made.starts(2), made.starts(9)) == ((), ((0, 1),), ())
    again = Proposals.of(Asked(), street.objective, (1, 1, 1))
    assert again.notes == ("not for one",)


def test_origins_tell_proposals_apart(street):
    made = Proposals.of(Asked(), street.objective, (1, 2))
    assert json.loads(json.dumps(made.origin)) == {
        "name": "somebody",
        "sets": [[1, []], [2, [0, 1]]],
        "notes": ["not for one"],
    }
    others = [
        Proposals("x", made.sets, made.notes),
        Proposals(made.name, {2: (0, 1)}),
        Proposals("somebody", {2: (0, 2)}),
    ]
    assert all(other.origin != made.origin for other in others)
