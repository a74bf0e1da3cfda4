import numpy as np
import pytest

from placement_env.envs.maps import junctions
from placement_env.envs.maps.junctions import drawn_candidates, prepare, prepared
from placement_env.fidelity.visibility import Visibility
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


def test_candidates_depend_on_the_seed():
    assert drawn_candidates(SITE, 3).digest() == drawn_candidates(SITE, 3).digest()
    assert len({drawn_candidates(SITE, seed).digest() for seed in range(4)}) == 4


@pytest.mark.slow
def test_a_real_one(tmp_path):
    junction = prepare(1, tmp_path, frames=2, places=2, poses=4)
    assert junction.visibility.points.max() > 0
    assert junction.site.network
