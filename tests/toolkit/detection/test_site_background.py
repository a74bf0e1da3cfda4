"""The background of a site: all that its sensors see there, and nobody who drives there."""

import numpy as np
import pytest

from toolkit.datasets.dataset import CoopDataset
from toolkit.detection import background as module
from toolkit.detection.background import (
    MAX_VOXELS,
    VOXEL_M,
    Background,
    choose_voxel,
    empty_sweeps,
    recording_background,
    site_background,
)
from toolkit.frame import Frame
from toolkit.geometry import LEVEL, level_rows
from toolkit.objects import Objects
from toolkit.points import Crop, frame_points
from toolkit.rendering.renderer import Renderer
from toolkit.sites.random import random_sensors, random_site
from toolkit.sites.site import Site


@pytest.fixture(scope="module", params=[3, pytest.param(5, marks=pytest.mark.slow)])
def place(request):
    """A site, what sensors measure there in two frames, and its background."""
    site = random_site(request.param)
    sensors = random_sensors(site, request.param, 4)
    background = Renderer(site, (), sensors, threads=1).background
    return (
        site,
        [Frame(sensors, background, Objects.empty(), float(k), k) for k in range(2)],
        site_background(site),
    )


@pytest.mark.one_in(2)
def test_the_site_is_background(place):
    site, frames, background = place
    clouds = frame_points(frames[0], area=site, rng=np.random.default_rng(0))
    points = level_rows(np.concatenate(clouds), site.relief.slope)
    assert len(points) > 2000
    assert background.holds(points).mean() > 0.995


def test_space_above_the_ground_is_no_background(place):
    site, frames, background = place
    rng = np.random.default_rng(1)
    (points,) = frame_points(frames[0], sensors=[0], area=site)
    ground = level_rows(points, site.relief.slope)
    ground = ground[np.abs(ground[:, 2]) < 0.1]
    assert len(ground) > 50
    clear = ground + rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 1.5], ground.shape)
    assert background.holds(clear).mean() < 0.1  # there are crowns, fences and works


@pytest.mark.one_in(2)
def test_what_is_behind_all_that_moves_is_background(place):
    site, _, background = place
    assert site_background(site).digest == background.digest
    assert random_site(3).relief.slope != LEVEL
    site, frames, background = place
    assert recording_background(Recorded(frames, site)).digest == background.digest
    bare = Recorded(frames, Site("bare", site.area, relief=site.relief))
    learnt = recording_background(bare)
    assert learnt.digest == Background.learn(np.concatenate(list(empty_sweeps(bare)))).digest
    assert len(list(empty_sweeps(bare))) == 4 * len(frames[0].sensors)
    again = np.concatenate(frame_points(frames[1], area=site, rng=np.random.default_rng(9)))
    assert learnt.holds(level_rows(again, site.relief.slope)).mean() > 0.97


@pytest.mark.parametrize("side", [200.0, 500.0, 1000.0, 10_000.0])
def test_a_large_area_has_coarser_voxels_and_as_many_as_memory_holds(side):
    voxel = choose_voxel(Crop((0.0, 0.0, side, side), 4.0))
    assert (voxel == VOXEL_M) == (side == 200.0)
    assert np.prod(np.array([side, side, 5.0]) / voxel + 5.0) < MAX_VOXELS


def test_a_coarser_background_still_is_what_sensors_see_of_the_site(place, limits):
    site, frames, background = place
    limits(module, AREA_VOXELS=1 << 20)
    coarse = site_background(site)
    assert VOXEL_M < coarse.voxel < 0.6
    assert coarse.occupied.size < background.occupied.size / 4
    points = level_rows(np.concatenate(frame_points(frames[0], area=site)), site.relief.slope)
    assert coarse.holds(points).mean() > 0.99


class Recorded(CoopDataset):
    """Stands for a recording: its frames, and its site."""

    def __init__(self, frames, site):
        self.frames, self.site = frames, site

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        return self.frames[index]


def test_what_is_far_off_or_overhead_is_not_kept():
    site = random_site(3)
    xmin, ymin, xmax, ymax = site.area
    background = site_background(site)
    size = np.array(background.occupied.shape) * background.voxel
    assert size[0] < xmax - xmin + 1
    assert size[1] < ymax - ymin + 1
    assert size[2] < 6.5
