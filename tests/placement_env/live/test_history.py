"""History of variants: steps back and forth, drags as one step, and copies that share nothing."""

import pickle
from copy import copy

import pytest

from placement_env.live.history import MAX_UNDO_STEPS, VariantHistory
from placement_env.live.variant import LiveSensor, Variant


def variant_with(count):
    """Variant that differs by its number of sensors."""
    sensor = LiveSensor("d0", "depth-camera", "post", 0.0, 0.0, 5.0, 0.0, 0.3)
    return Variant((sensor,) * count)


@pytest.fixture
def history():
    return VariantHistory(variant_with(0))


def test_steps_lead_back_and_forth(history):
    assert history.change(variant_with(1))
    assert history.change(variant_with(2))
    history.undo()
    assert (history.variant, len(history.past_steps), len(history.future)) == (
        variant_with(1),
        1,
        1,
    )
    history.redo()
    assert (history.variant, history.future) == (variant_with(2), ())
    history.undo()
    assert history.change(variant_with(3))
    assert history.future == ()  # a new change forgets what was undone
    with pytest.raises(ValueError, match="there is nothing to redo"):
        history.redo()


def test_what_changes_nothing_is_no_step_and_keeps_the_future(history):
    history.change(variant_with(1))
    history.undo()
    assert not history.change(variant_with(0))
    assert (history.past_steps, len(history.future)) == ((), 1)


def test_a_drag_goes_on_until_another_change(history):
    history.change(variant_with(1))
    history.drag("d0")
    assert history.is_dragged("d0")
    assert not history.is_dragged("d1")
    assert not history.change(variant_with(2), continues_drag=True)
    assert not history.is_dragged("d0")
    history.undo()
    assert history.variant == variant_with(0)


def test_variants_are_shown_by_name_and_steps_lead_to_theirs(history):
    history.show("B", copy=True)
    history.change(variant_with(1))
    history.show("A", copy=False)
    history.undo()
    assert (history.current, history.variant) == ("B", variant_with(0))
    for name, is_copy, problem in (
        ("A", True, "'A' is taken: the variants are A, B"),
        ("C", False, "'C' is unknown: the variants are A, B"),
        ("", True, "a name must be one line"),
    ):
        with pytest.raises(ValueError, match=problem):
            history.show(name, copy=is_copy)
    assert history.current == "B"


def test_steps_are_bounded(history):
    for count in range(MAX_UNDO_STEPS + 2):
        history.change(variant_with(1 + count % 2))
    assert len(history.past_steps) == MAX_UNDO_STEPS


@pytest.mark.parametrize("duplicate", [copy, lambda history: pickle.loads(pickle.dumps(history))])
def test_a_copy_goes_its_own_way(history, duplicate):
    history.change(variant_with(1))
    copied = duplicate(history)
    copied.undo()
    copied.show("B", copy=True)
    assert (history.variant, len(history.past_steps), history.future) == (variant_with(1), 1, ())
    assert list(history.variants) == ["A"]
