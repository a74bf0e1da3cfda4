"""A plan on a Ray cluster that loses a machine is the plan that one process makes."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

PLAN = (
    "plan",
    "tjunction",
    "--candidates",
    "paper",
    "--budget",
    2,
    "--frames",
    40,
    "--cache",
    "None",
    "--json",
)


def work_begun_below(raylet):
    """Process ids of a node's workers that have begun a job; Ray writes its name over their command
    line."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == raylet and b"_work_on_ray" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except OSError:  # it has ended
            continue
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="workers are found in /proc")
def test_a_plan_is_the_same_when_one_of_two_nodes_is_killed(two_nodes, tmp_path, run):
    cluster, second = two_nodes
    raylet = second.all_processes["raylet"][0].process.pid
    killed = []

    def kill_second() -> None:
        while not (there := work_begun_below(raylet)):
            time.sleep(0.01)
        for pid in (raylet, *there):
            os.kill(pid, signal.SIGKILL)
        killed.extend(there)

    threading.Thread(target=kill_second, daemon=True).start()
    code, _, err = run(*PLAN, "--ray", cluster.address, "--out", tmp_path / "cluster")
    assert code == 0, err
    assert killed
    code, _, err = run(*PLAN, "--workers", 1, "--out", tmp_path / "alone")
    assert code == 0, err
    cluster_plan, plan = (
        (tmp_path / name / "plan.json").read_bytes() for name in ("cluster", "alone")
    )
    assert cluster_plan == plan
