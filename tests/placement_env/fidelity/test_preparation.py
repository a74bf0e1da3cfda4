"""What the fidelities of one objective are made from, and what of it is kept on disk."""

from dataclasses import replace

import numpy as np
import pytest

from models.detector import VoxelNetDetector
from models.detector_loading import load_detector
from placement_env.cases import Cases
from placement_env.fidelity import preparation, seeing
from placement_env.fidelity.preparation import Preparation, check_scorable
from placement_env.fidelity.shipped import GENERAL, find_network, load_shipped_detector
from placement_env.setting import Setting
from toolkit.detection.background import KnownBackground, add_background
from toolkit.detection.schemes import find_scheme
from toolkit.objects import Detections
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR, TYPICAL
from toolkit.sites.files import load_site


class Nothing:
    digest = "nothing"

    def __call__(self, points):
        return Detections.empty()


def prepared(traffic, candidates, cache, errors=PAPER_ERRORS, combine="worst", **fields):
    made = Preparation(
        Setting(
            traffic.site,
            candidates=candidates,
            scheme=find_scheme("late"),
            cases=Cases(errors=errors, errors_by=combine),
            **{"detector": Nothing(), **fields},
        ),
        Run(frames=5, cache=cache),
    )
    vars(made)["traffic"] = traffic
    return made


def test_one_file_of_the_folder_keeps_what_was_seen_rendered_and_detected(
    small_traffic, small_candidates, tmp_path, fail
):
    first = prepared(small_traffic, small_candidates, tmp_path / "cache")
    seen, detected = first.visibility, first.fidelity("detector")
    sets = [[True, True, False, False]]
    detected(np.array(sets))
    kept = len(first.run.memo)
    assert (
        kept == 1 + 2 * 6 + 5 + 10
    )  # a block, two renders in parts, an outcome and two detections of each frame
    assert {path.name.partition("-")[0] for path in (tmp_path / "cache").iterdir()} == {
        "cache.sqlite",
        "cache.sqlite.key",
    }
    fail(seeing, "look_at")
    again = prepared(small_traffic, small_candidates, tmp_path / "cache")
    assert (again.visibility.points == seen.points).all()
    again.fidelity("detector")(np.array(sets))
    assert len(again.run.memo) == kept


def test_sensors_are_seen_live_and_nothing_kept_without_a_folder(small_traffic, small_candidates):
    assert prepared(small_traffic, small_candidates, None).run.memo is None

    def live(candidates=small_candidates, rendering="auto"):
        made = Preparation(
            Setting(small_traffic.site, candidates=candidates, rendering=rendering), Run(frames=5)
        )
        vars(made)["traffic"] = small_traffic
        return made.live

    assert live().traffic is small_traffic
    assert live(rendering="full") is None
    assert live(rendering="panorama").traffic is small_traffic
    lidar = small_candidates.sensors[3]
    short = replace(
        small_candidates.select([3]),
        sensors=(replace(lidar, model=replace(lidar.model, max_range=15.0)),),
    )
    assert live(rendering="panorama", candidates=short) is None


def test_errors_change_what_the_detector_sees_and_every_key_of_it(
    small_traffic, small_candidates, tmp_path
):
    sets = np.array([[True, True, False, False]])
    kept = []
    for errors in (PAPER_ERRORS, TYPICAL, POOR, TYPICAL, PAPER_ERRORS):
        made = prepared(small_traffic, small_candidates, tmp_path, errors=errors)
        made.fidelity("detector")(sets)
        kept.append(len(made.run.memo))
    assert np.diff(kept).tolist() == [
        2 * 6 + 5 + 10,
        5 + 10,
        0,
        0,
    ]  # whole renders once, outcomes and detections of each


@pytest.mark.parametrize("combine", ["worst", "mean"])
def test_several_profiles_share_traffic_and_detector_and_what_single_ones_have_kept(
    small_traffic, small_candidates, tmp_path, combine
):
    sets = np.array([[True, True, False, False]])
    single = [
        prepared(small_traffic, small_candidates, tmp_path, errors=each)
        for each in (PAPER_ERRORS, POOR)
    ]
    each = [made.fidelity("detector")(sets) for made in single]
    kept = len(single[0].run.memo)
    both = prepared(
        small_traffic, small_candidates, tmp_path, errors=(PAPER_ERRORS, POOR), combine=combine
    )
    found = both.fidelity("detector")
    at_each = found.at_each(sets)
    assert [at_each[name].kbit.tolist() for name in ("paper", "poor")] == [
        one.kbit.tolist() for one in each
    ]
    assert found(sets).ap.tolist() == [0.0]
    assert len(both.run.memo) == kept  # neither rendered nor detected again
    with pytest.raises(
        ValueError, match="errors paper and poor are known to fidelity detector alone"
    ):
        both.fidelity("coverage")


def test_the_shipped_network_is_read_once_for_all_profiles(small_traffic, small_candidates, spy):
    calls = spy(preparation, "load_shipped_detector")
    made = prepared(small_traffic, small_candidates, None, errors=(TYPICAL, POOR), detector=None)
    made.fidelity("detector")
    assert [call.args[0] for call in calls] == [GENERAL]


@pytest.mark.parametrize("name", ["coverage", "surrogate", "table"])
def test_fidelities_that_do_not_know_errors_refuse_them(small_traffic, small_candidates, name):
    made = prepared(small_traffic, small_candidates, None, errors=TYPICAL)
    with pytest.raises(
        ValueError, match=f"errors typical are known to fidelity detector alone, got '{name}'"
    ):
        made.fidelity(name)
    check_scorable(made.setting, "detector")


def test_the_general_network_knows_a_site_empty_and_a_sites_own_is_as_it_was_trained():
    site = load_site("tjunction")
    own, general = (load_shipped_detector(name, site) for name in ("tjunction", GENERAL))
    assert isinstance(own, VoxelNetDetector)
    assert isinstance(general, KnownBackground)
    assert general.digest == add_background(load_detector("general", area=site.area), site).digest
    assert load_shipped_detector(GENERAL, load_site("tjunction")) is general
    other = load_shipped_detector(GENERAL, replace(site, solids=site.solids[1:]))
    assert isinstance(other, KnownBackground)
    assert other.digest != general.digest
    assert find_network(site, site.sensors) == "tjunction"
    assert find_network(site, [replace(site.sensors[0], name="elsewhere")]) == GENERAL


def test_models_are_read_once_for_sensors_that_move(small_traffic, small_candidates, seen, fail):
    prepared = Preparation(
        Setting(small_traffic.site, candidates=small_candidates, scheme=find_scheme("early")),
        Run(frames=5),
    )
    vars(prepared)["traffic"] = small_traffic
    first, second = (prepared.with_candidates(small_candidates, seen) for _ in range(2))
    sets = np.eye(len(small_candidates), dtype=bool)
    ap = first.fidelity("surrogate")(sets).ap
    fail(preparation, "surrogate_models")
    assert second.fidelity("surrogate")(sets).ap.tolist() == ap.tolist()
    assert (
        prepared.with_candidates(small_candidates, seen).fidelity("surrogate")(sets).ap.tolist()
        == ap.tolist()
    )
