import os
import pickle
from importlib.util import find_spec

import pytest

from toolkit.runtime.run import Processes, Run


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"workers": 0},
            "workers must be a whole number of at least 1, got 0: None takes one per core",
        ),
        ({"workers": 1.5}, "workers must be a whole number of at least 1, got 1.5"),
        ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"frames": 0}, "frames must be a whole number of at least 1, got 0"),
        ({"cache": __file__}, "the cache is a folder, got the file .*: give another path"),
    ],
)
def test_fields_are_checked(fields, message):
    with pytest.raises(ValueError, match=message):
        Run(**fields)


def test_a_cluster_needs_ray(without_packages):
    without_packages("ray")
    with pytest.raises(ImportError, match=r"pip install coview\[scale\]"):
        Processes(ray="local")
    assert Processes(workers=2).count == 2  # processes of this machine do not


@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
def test_a_cluster_is_taken_with_ray():
    run = Processes(ray="local")
    assert run.ray == "local"
    assert not run.has_one_process


def test_work_is_done_in_order_by_as_many_workers():
    told = []
    run = Run(progress=lambda *stage: told.append(stage))
    assert list(run.map(abs, [-2, 1], progress=run.stage("numbers", 2))) == [2, 1]
    assert told == [("numbers", 1, 2), ("numbers", 2, 2)]
    assert Run().stage("numbers") is None
    assert list(Run(workers=2).map(abs, range(-5, 0))) == [5, 4, 3, 2, 1]
    assert Run().has_one_process
    assert not Run(workers=2).has_one_process
    assert Processes(workers=None).count == os.cpu_count()


def test_runs_go_to_other_processes_with_one_cache(tmp_path):
    run = Run(seed=3, frames=5, cache=tmp_path, progress=print)
    there = pickle.loads(pickle.dumps(run))
    assert there == run
    assert there.progress is None
    run = Run(cache=str(tmp_path))
    assert run.memo is run.memo
    assert run.cache == tmp_path
    assert Run().memo is None
    run.memo.put({b"key": ()})
    assert (tmp_path / "cache.sqlite").is_file()
