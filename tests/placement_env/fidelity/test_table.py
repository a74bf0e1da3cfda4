import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from placement_env.fidelity.detector import IOUS, Detected
from placement_env.fidelity.table import (
    SHIPPED,
    Table,
    TableFidelity,
    TableOrigin,
    best_sets,
    hash_site,
    load_table,
    make_table,
    save_table,
)
from placement_env.objective import Objective
from placement_env.protocol import Fidelity
from placement_env.setting import Setting
from placement_env.subsets import all_subsets
from toolkit.boxes import count_points
from toolkit.detection.schemes import PAPER_SCHEMES as SCHEMES
from toolkit.objects import Detections, Objects
from toolkit.runtime.array_files import read_arrays, write_arrays
from toolkit.runtime.run import Processes
from toolkit.sensors.error_profiles import TYPICAL
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

PLACES = np.array([-20.0, -10, 0, 10, 20])


def cars(x):
    one = np.ones_like(x)
    return np.column_stack([x, 0 * x, 0.75 * one, 4 * one, 2 * one, 1.5 * one, 0 * x])


@dataclass
class Street:
    """Cars near the places; each of three sensors has points on some of them."""

    frames: int = 3
    site = Site("street", np.array([-40.0, -20.0, 40.0, 20.0]))
    sensors = tuple(Sensor(f"s{c}", DepthCamera(), np.eye(4)) for c in range(3))
    digest = "street"

    def clouds(self, k, c):
        rng = np.random.default_rng([k, c])
        return np.column_stack(
            [rng.uniform(-25, 25, 40), rng.uniform(-1, 1, 40), rng.uniform(0, 1, 40)]
        ).astype("f4")

    def objects(self, k):
        return Objects(cars(PLACES + np.random.default_rng(k).uniform(-0.8, 0.8, 5)))


class Guess:
    """A car at each place with points; it fails at one of its calls."""

    digest = "guess"

    def __init__(self, fails=-1):
        self.calls, self.fails = 0, fails

    def __call__(self, points):
        self.calls += 1
        if self.calls == self.fails:
            raise KeyboardInterrupt
        counts = count_points(points, cars(PLACES))
        return Detections(cars(PLACES), counts / 50.0)[counts > 1]


def same(a, b):
    return a.origin == b.origin and all(
        getattr(a, name).tobytes() == getattr(b, name).tobytes()
        for name in ("ap", "recall", "kbit")
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder, told, detector = tmp_path_factory.mktemp("table"), [], Guess()
    processes = Processes(progress=lambda _, *done: told.append(done))
    table = make_table(
        Street(), detector, folder / "street.npz", seed=4, commit="abc", processes=processes
    )
    return table, folder / "street.npz", told, detector.calls


def test_a_table_holds_what_detection_gives_and_says_where_from(made):
    table, path, told, _ = made
    place = hash_site(Street().site, Street().sensors)
    assert table.origin == TableOrigin(
        "street", ("s0", "s1", "s2"), place, 3, 15, "street", "guess", 4, "abc"
    )
    assert told == [(k, 9) for k in range(1, 10)]
    for i, scheme in enumerate(SCHEMES):
        expected = Detected(Street(), Guess(), scheme).estimates(table.subsets)
        for j, iou in enumerate(IOUS):
            np.testing.assert_array_equal(table.ap[:, i, j], expected[iou].ap)
            np.testing.assert_array_equal(table.recall[:, i, j], expected[iou].recall)
            np.testing.assert_array_equal(table.kbit[:, i], expected[iou].kbit)
    assert 0.1 < table.ap[-1].max() <= 1
    assert [each.name for each in path.parent.iterdir()] == ["street.npz"]
    assert same(load_table(path), table)


@pytest.mark.slow
def test_tables_in_parts_and_processes_have_the_same_bytes(made, tmp_path):
    table, path, _, all_calls = made
    first, second = Guess(fails=all_calls - 8), Guess()
    with pytest.raises(KeyboardInterrupt):
        make_table(Street(), first, tmp_path / "t.npz", seed=4, commit="abc")
    assert not (tmp_path / "t.npz").exists()
    assert same(make_table(Street(), second, tmp_path / "t.npz", seed=4, commit="abc"), table)
    assert second.calls < all_calls / 2
    assert (tmp_path / "t.npz").read_bytes() == path.read_bytes()
    _, path, _, _ = made
    make_table(
        Street(), Guess(), tmp_path / "t.npz", seed=4, commit="abc", processes=Processes(workers=2)
    )
    assert (tmp_path / "t.npz").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("iou", IOUS)
def test_lookups_are_those_of_detection_in_any_order(made, scheme, iou):
    fidelity = TableFidelity(made[0], scheme, iou)
    assert isinstance(fidelity, Fidelity)
    rows = np.random.default_rng(0).permutation(np.repeat(np.arange(8), 2))
    expected = Detected(Street(), Guess(), scheme, iou=iou)(all_subsets(3))
    for found, values in zip(fidelity(all_subsets(3)[rows]), expected, strict=True):
        np.testing.assert_array_equal(found, values[rows])
    assert [float(each[0]) for each in fidelity(np.zeros((1, 3), bool))] == [0, 0, 0]


def test_rows_are_bit_masks_and_best_sets_the_best_of_their_size():
    table = some_table(4)
    np.testing.assert_array_equal(table.row(table.subsets), np.arange(16))
    assert table.row(np.array([[False, True, False, True]])).tolist() == [0b1010]
    table = some_table(4)
    best = best_sets(table, "late", 0.8, top=2)
    assert list(best) == [4, 3, 2, 1]
    assert [len(sets) for sets in best.values()] == [1, 2, 2, 2]
    for size, sets in best.items():
        rows = np.flatnonzero(table.subsets.sum(axis=1) == size)
        assert [each.ap for each in sets] == sorted(table.ap[rows, 1, 1], reverse=True)[:2]
        for each in sets:
            assert table.ap[sum(1 << c for c in each.sensors), 1, 1] == each.ap


def some_table(sensors):
    ap = np.random.default_rng(0).random((1 << sensors, 3, 3))
    names = tuple(f"d{c}" for c in range(sensors))
    return Table(TableOrigin("x", names, "", 1, 1, "", "", 0, ""), ap, ap, ap[:, :, 0].copy())


def test_bad_requests_and_files_of_something_else_are_refused(tmp_path):
    table = some_table(3)
    with pytest.raises((ValueError, TypeError), match="middle"):
        TableFidelity(table, "middle")
    with pytest.raises(ValueError, match=r"0\.5"):
        TableFidelity(table, "late", 0.5)
    with pytest.raises(ValueError, match="3 sensors"):
        TableFidelity(table)(np.zeros((2, 4), bool))
    with pytest.raises(ValueError, match="must be"):
        replace(table, ap=table.ap[:5], recall=table.recall[:5], kbit=table.kbit[:5])
    with pytest.raises(ValueError, match="too many"):
        all_subsets(17)
    with pytest.raises(FileNotFoundError, match="no table 'nowhere'"):
        load_table("nowhere")
    np.savez(tmp_path / "t.npz", ap=np.zeros(3))
    with pytest.raises(ValueError, match="not a coview file"):
        load_table(tmp_path / "t.npz")
    write_arrays(tmp_path / "t.npz", {"ap": np.zeros(3)})
    with pytest.raises(ValueError, match="no table"):
        load_table(tmp_path / "t.npz")
    write_arrays(
        tmp_path / "t.npz", {"origin": np.frombuffer(json.dumps({"site": 1}).encode(), np.uint8)}
    )
    with pytest.raises(ValueError, match="no table"):
        load_table(tmp_path / "t.npz")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        *(
            ("ap", 2.0, "AP and recall must lie in 0..1, got 2"),
            ("recall", np.nan, "must lie in 0..1, got nan"),
        ),
        *(("more_ap", -0.1, "0..1, got -0.1"), ("kbit", -5.0, "kbit must lie in .*, got -5")),
        *(("kbit", each, "kbit must lie in") for each in (np.nan, np.inf, -5.0, 1e9)),
    ],
)
def test_figures_that_cannot_be_are_refused(tmp_path, name, value, says):
    arrays = read_arrays(SHIPPED / "tjunction.npz")
    arrays[name].flat[5] = value
    write_arrays(tmp_path / "t.npz", arrays)
    with pytest.raises(ValueError, match=rf"t.npz is no table .*{says}.*: make it again"):
        load_table(tmp_path / "t.npz")


@pytest.mark.parametrize("size", [0, 10, 300, -30])
def test_a_damaged_file_is_refused_in_one_line(tmp_path, size):
    save_table(some_table(3), tmp_path / "t.npz")
    (tmp_path / "t.npz").write_bytes((tmp_path / "t.npz").read_bytes()[:size])
    with pytest.raises(ValueError, match=r"damaged|no table"):
        load_table(tmp_path / "t.npz")


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.npz")), ids=lambda path: path.stem)
def test_shipped_tables_are_whole_and_small(path):
    table = load_table(path.stem)
    assert table.origin.site == path.stem
    assert ((table.ap >= 0) & (table.ap <= table.recall)).all()
    assert (table.ap[0] == 0).all()
    assert path.stat().st_size < 80_000


def test_a_table_knows_its_radius_and_errors(tmp_path):
    """Its origin says so; the shipped ones, from before, have the paper's."""
    assert [load_table(name).origin.hybrid_radius for name in ("tjunction", "roundabout")] == [
        20.0,
        12.0,
    ]
    site = load_site("roundabout")
    with pytest.raises(ValueError, match="not of these candidates or this version of the site"):
        Objective(Setting(replace(site, hybrid_radius=20.0), fidelity="table"))
    far = replace(some_table(3), origin=replace(some_table(3).origin, hybrid_radius=5.0))
    save_table(far, tmp_path / "t.npz")
    assert load_table(tmp_path / "t.npz").origin.hybrid_radius == 5.0
    assert make_table(Street(), Guess(), tmp_path / "a.npz").origin.errors == "paper"
    rough = Street()
    vars(rough)["errors"] = TYPICAL
    assert make_table(rough, Guess(), tmp_path / "b.npz").origin.errors == "typical"
    assert load_table(tmp_path / "b.npz").origin.errors == "typical"
    assert load_table("tjunction").origin.errors == "paper"
