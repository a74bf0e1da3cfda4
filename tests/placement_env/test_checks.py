"""The rules for numbers that users give: what passes, and one line for what does not."""

from typing import Any

import numpy as np
import pytest

from placement_env.checks import check_iou, check_range, check_whole


@pytest.mark.parametrize("value", [1, 7, np.int64(2)])
def test_whole_numbers_pass(value: Any) -> None:
    check_whole("frames", value, least=1)
    check_range("budget", value, least=1, unit="sensor")
    check_range("budget", (1, value), least=1, unit="sensor")


@pytest.mark.parametrize("value", [0, -1, 1.0, 1.5, True, "2", None])
def test_others_are_refused(value: Any) -> None:
    with pytest.raises(ValueError, match="frames must be a whole number of at least 1, got"):
        check_whole("frames", value, least=1)
    with pytest.raises(ValueError, match="budget must be at least 1 sensor"):
        check_range("budget", value, least=1, unit="sensor")


@pytest.mark.parametrize("value", [(3, 2), (0, 2), (1, 2, 3), (1, 2.5), ()])
def test_what_is_no_range_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"\(lowest, highest\)"):
        check_range("budget", value, least=1, unit="sensor")


@pytest.mark.parametrize("value", [0.7, 1, np.float32(0.5)])
def test_an_iou_lies_above_0_and_up_to_1(value: Any) -> None:
    check_iou(value)


@pytest.mark.parametrize("value", [0.0, -0.1, 1.01, float("nan"), "0.7", True, None])
def test_other_ious_are_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"iou must lie in \(0, 1\]"):
        check_iou(value)
