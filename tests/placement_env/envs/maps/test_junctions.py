from dataclasses import replace

import numpy as np
import pytest

from placement_env.envs.maps import junctions
from placement_env.envs.maps.junctions import (
    JunctionSource,
    drawn_candidates,
    other_traffic,
    prepare,
    prepare_from,
    prepared,
)
from placement_env.fidelity.visibility import Visibility
from toolkit.sites.files import save_site
from toolkit.sites.site import Mount, Site

SITE = Site(
    "plain",
    np.array([-20.0, -20.0, 20.0, 20.0]),
    mounts=tuple(Mount(f"m{k}", np.array([10.0 * k - 20, 21.0, 0.0])) for k in range(4)),
)


@pytest.fixture
def rendered(monkeypatch):
    """What was rendered, counted; nothing is simulated."""
    calls = []

    def see(traffic, candidates, *, rendering):
        calls.append(traffic)
        count, (_, frames, seed) = len(candidates), traffic
        points = np.full((count, 6), float(seed), np.float32)
        columns = (np.zeros(6, np.int64), np.ones((6, 7)), *np.ones((2, count, frames), np.float32))
        return Visibility(points, points, *columns)

    monkeypatch.setattr(junctions, "random_site", lambda seed: SITE)
    monkeypatch.setattr(junctions, "simulate_traffic", lambda site, frames, seed: (site.name, frames, seed))
    monkeypatch.setattr(junctions, "see", see)
    return calls


def test_each_is_rendered_once_and_read_afterwards(rendered, tmp_path):
    first = list(prepared([3, 5], tmp_path / "new", frames=4, places=2, poses=3))
    assert [call[1:] for call in rendered] == [(4, 3), (4, 5)]
    again = list(prepared([3, 5], tmp_path / "new", frames=4, places=2, poses=3))
    assert len(rendered) == 2
    for one, two in zip(first, again, strict=True):
        assert one.site == two.site == SITE
        assert one.candidates.digest() == two.candidates.digest()
        assert (one.visibility.points == two.visibility.points).all()
    assert first[1].visibility.points[0, 0] == 5
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "000003.geojson", "000003.npz", "000005.geojson", "000005.npz"
    ]  # fmt: skip


def test_what_was_broken_off_goes_on(rendered, tmp_path):
    prepare(3, tmp_path, frames=4)
    (tmp_path / "000003.npz").unlink()
    prepare(3, tmp_path, frames=4)
    assert len(rendered) == 2


def test_files_of_something_else(rendered, tmp_path):
    prepare(3, tmp_path, frames=4, places=2, poses=3)
    for other in ({"frames": 5, "places": 2, "poses": 3}, {"frames": 4, "places": 2, "poses": 4}):
        with pytest.raises(ValueError, match=r"000003.npz is of \d+ candidates and 4 frames, .* remove it"):
            prepare(3, tmp_path, **other)
    (tmp_path / "000003.npz").write_bytes(b"nothing of ours")
    with pytest.raises(ValueError, match="does not fit its checksum"):
        prepare(3, tmp_path, frames=4, places=2, poses=3)
    with pytest.raises(ValueError, match="seed must be a whole number"):
        prepare(-1, tmp_path)


def test_own_sites(rendered, tmp_path):
    save_site(SITE, tmp_path / "mine.json")
    one, other = (JunctionSource.of_site(tmp_path / "mine.json", draw) for draw in (0, 1))
    assert (one.name[:-2], one.seed, other.seed) == (other.name[:-2], 0, 1)
    first = prepare_from(one, tmp_path / "new", frames=4)
    prepare_from(other, tmp_path / "new", frames=4)
    prepare_from(one, tmp_path / "new", frames=4)
    assert first.site == SITE
    assert [call[1:] for call in rendered] == [(4, 0), (4, 1)]
    save_site(replace(SITE, name="changed"), tmp_path / "mine.json")
    assert JunctionSource.of_site(tmp_path / "mine.json").name[:-2] != one.name[:-2]
    assert JunctionSource.of_seed(12) == JunctionSource("000012", 12)
    assert JunctionSource.of_site("tjunction").name == JunctionSource.of_site("tjunction").name
    with pytest.raises(FileNotFoundError, match="no site"):
        JunctionSource.of_site(tmp_path / "none.json")
    with pytest.raises(ValueError, match="draw must be a whole number"):
        JunctionSource.of_site("tjunction", -1)


def test_other_traffic_is_kept_beside(rendered, tmp_path):
    source = JunctionSource.of_seed(3)
    junction = prepare_from(source, tmp_path, frames=4)
    seen = other_traffic(source, junction, tmp_path, frames=5)
    assert rendered[-1] == ("plain", 5, 500_003)
    assert (tmp_path / "searched" / "000003.npz").exists()
    assert (other_traffic(source, junction, tmp_path, frames=5).points == seen.points).all()
    assert len(rendered) == 2
    with pytest.raises(ValueError, match="and 5 frames, not of"):
        other_traffic(source, junction, tmp_path, frames=6)


def test_candidates_depend_on_the_seed():
    assert drawn_candidates(SITE, 3).digest() == drawn_candidates(SITE, 3).digest()
    assert len({drawn_candidates(SITE, seed).digest() for seed in range(4)}) == 4


@pytest.mark.slow
def test_a_real_one(tmp_path):
    junction = prepare(1, tmp_path, frames=2, places=2, poses=4)
    assert junction.visibility.points.max() > 0
    assert junction.site.network
