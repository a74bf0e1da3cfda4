"""`DetectorSpec`: what a detector's name and its suffixes mean."""

import pytest

from coview.detector_spec import DetectorSpec
from toolkit.sites.files import load_site


@pytest.mark.parametrize(
    ("name", "spec"),
    [
        ("general", DetectorSpec("general", "general")),
        (
            "my.package:detect+background",
            DetectorSpec("my.package:detect+background", "my.package:detect", background=True),
        ),
        ("background", DetectorSpec("background", "background")),
        ("a+phases3.safetensors", DetectorSpec("a+phases3.safetensors", "a+phases3.safetensors")),
        (
            "general+bfloat16+background+phases12",
            DetectorSpec("general+bfloat16+background+phases12", "general", True, 12, "bfloat16"),
        ),
        (
            "general+float32+bfloat16",
            DetectorSpec("general+float32+bfloat16", "general", numbers="float32"),
        ),
        ("general-background", DetectorSpec("general-background", "general", background=False)),
    ],
)
def test_a_name_is_parsed_once(name, spec) -> None:
    assert DetectorSpec.from_name(name) == spec


@pytest.mark.parametrize(
    ("name", "knows"), [("general", True), ("general+phases2", True), ("general-background", False)]
)
def test_general_knows_the_scenery_of_a_site(name, knows) -> None:
    spec = DetectorSpec.from_name(name)
    assert spec.knows_background(load_site("tjunction")) is knows
    assert not spec.knows_background()


@pytest.mark.parametrize(
    ("name", "learns"),
    [
        ("general", True),
        ("general+phases4", True),
        ("general-background", False),
        ("general+background", False),
        ("mine.safetensors", False),
    ],
)
def test_general_learns_the_scene_of_an_unknown_site(name, learns) -> None:
    assert DetectorSpec.from_name(name).learns_scene is learns


@pytest.mark.parametrize(
    ("name", "onnx", "imported", "at_site"),
    [
        ("a.onnx", True, False, False),
        ("package.module:detect", False, True, False),
        ("voxelnet", False, False, True),
        ("cluster+background", False, False, True),
        ("tjunction", False, False, False),
    ],
)
def test_kinds_of_detectors(name, onnx, imported, at_site) -> None:
    spec = DetectorSpec.from_name(name)
    assert (spec.is_onnx, spec.is_imported, spec.needs_site) == (onnx, imported, at_site)


@pytest.mark.parametrize(
    ("spec", "name"),
    [
        (DetectorSpec.from_name("a+background").without_background(), "a-background"),
        (DetectorSpec.from_name("general").in_bfloat16(), "general+bfloat16"),
        (DetectorSpec.from_name("general+float32").in_bfloat16(), "general+float32+bfloat16"),
        (DetectorSpec.from_name("general+phases4-background").without_suffixes(), "general"),
    ],
)
def test_a_changed_spec_is_that_of_its_name(spec, name) -> None:
    changed = DetectorSpec.from_name(name)
    assert (spec.base, spec.background, spec.phases, spec.numbers) == (
        changed.base,
        changed.background,
        changed.phases,
        changed.numbers,
    )
