"""`set_fields` and `set_cached`: values of a frozen dataclass while it is built."""

from dataclasses import FrozenInstanceError, dataclass
from functools import cached_property

import pytest

from toolkit.frozen import set_cached, set_fields


@dataclass(frozen=True)
class Length:
    metres: float

    def __post_init__(self) -> None:
        set_fields(self, metres=float(self.metres))

    @cached_property
    def feet(self) -> float:
        return self.metres / 0.3048


def test_a_field_is_set_while_the_object_is_built_and_frozen_afterwards() -> None:
    length = Length("2")  # type: ignore[arg-type]
    assert length == Length(2.0)
    with pytest.raises(FrozenInstanceError):
        length.metres = 3.0  # type: ignore[misc]


def test_a_known_property_is_not_computed() -> None:
    length = Length(2)
    set_cached(length, feet=7.0)
    assert length.feet == 7.0


@pytest.mark.parametrize(
    ("setter", "name"), [(set_fields, "feet"), (set_cached, "metres"), (set_cached, "yards")]
)
def test_an_unknown_name_is_refused(setter, name) -> None:
    with pytest.raises(AttributeError, match=f"Length has no such value: {name}"):
        setter(Length(2), **{name: 1.0})
