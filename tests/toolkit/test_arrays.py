"""Shapes in types, and what becomes of them on a machine without jaxtyping."""

import importlib.util

import jaxtyping
import numpy as np
import pytest

from toolkit import arrays

NAMES = ("Bool", "Float", "Float32", "Float64", "Int", "Int32", "Int64", "Shaped")


@pytest.fixture
def bare(without_packages):
    """The module as a training machine has it."""
    without_packages("jaxtyping")
    spec = importlib.util.spec_from_file_location("bare_arrays", arrays.__file__)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", NAMES)
def test_here_the_types_are_those_of_jaxtyping(name):
    assert getattr(arrays, name) is getattr(jaxtyping, name)


@pytest.mark.parametrize("name", NAMES)
def test_without_jaxtyping_an_annotation_means_the_array(bare, name):
    assert getattr(bare, name)[np.ndarray, "n 3"] is np.ndarray


@pytest.mark.parametrize(
    ("array", "fits"), [(np.zeros((2, 3)), True), (np.zeros((2, 4)), False), (np.zeros(3), False)]
)
def test_a_shape_is_part_of_the_type(array, fits):
    assert isinstance(array, arrays.Float64[np.ndarray, "n 3"]) == fits
