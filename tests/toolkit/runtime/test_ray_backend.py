"""A Ray cluster gives what a plain loop gives, whoever is killed on it."""

import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from toolkit.runtime.parallel import spread


def square(x: int) -> int:
    if x == 13:
        raise ValueError("unlucky")
    return x * x


@dataclass(frozen=True)
class DiesOnce:
    """Squares, but the first process that gets `victim` is killed over it; `big` is what a scene would be."""

    folder: Path
    victim: int
    big: bytes = bytes(1_000_000)

    def __call__(self, x: int) -> int:
        mark = self.folder / "killed"
        if x == self.victim and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return x * x


@dataclass
class Stuck:
    """Squares, noting in a file on which node and in which process each was begun; on one node it never ends."""

    log: Path
    node: str

    def __call__(self, x: int) -> int:
        import ray

        node = ray.get_runtime_context().get_node_id()
        with self.log.open("a") as file:
            file.write(f"{x} {node} {os.getpid()}\n")
        time.sleep(3600 if node == self.node else 0.1)
        return x * x


@pytest.fixture(scope="module")
def two_nodes():
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 100_000_000}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    yield cluster, cluster.add_node(**node)
    cluster.shutdown()


@pytest.mark.slow
def test_ray_gives_what_a_loop_gives(two_nodes):
    cluster, _ = two_nodes
    assert list(spread(square, range(12), ray=cluster.address)) == [x * x for x in range(12)]
    with pytest.raises(ValueError, match=r"^unlucky$"):
        list(spread(square, [1, 13, 2], ray=cluster.address))


@pytest.mark.slow
def test_ray_does_the_work_of_a_killed_process_again(two_nodes, tmp_path):
    cluster, _ = two_nodes
    assert list(spread(DiesOnce(tmp_path, 5), range(9), ray=cluster.address)) == [x * x for x in range(9)]
    assert (tmp_path / "killed").exists()


@pytest.mark.slow
def test_ray_goes_on_when_one_of_two_nodes_is_killed_in_mid_run(two_nodes, tmp_path):
    cluster, second = two_nodes
    log = tmp_path / "begun"

    def kill_second() -> None:  # as when the power fails, when it has begun to work
        while not (there := [int(pid) for _, node, pid in begun(log) if node == second.node_id]):
            time.sleep(0.01)
        for pid in (second.all_processes["raylet"][0].process.pid, *there):
            os.kill(pid, signal.SIGKILL)

    threading.Thread(target=kill_second, daemon=True).start()
    assert list(spread(Stuck(log, second.node_id), range(30), ray=cluster.address)) == [x * x for x in range(30)]
    numbers = [x for x, _, _ in begun(log)]
    assert len(numbers) > len(set(numbers)) == 30  # something was done again


def begun(log: Path) -> list[list[str]]:
    return [line.split() for line in log.read_text().splitlines()] if log.exists() else []


def test_an_address_without_a_cluster_is_told_in_one_line():
    pytest.importorskip("ray")
    with pytest.raises(ConnectionError, match="ray start --head") as error:
        next(spread(square, [1], ray="127.0.0.1:1"))
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_cluster_of_this_machine_alone():
    pytest.importorskip("ray")
    assert list(spread(square, range(5), ray="local")) == [0, 1, 4, 9, 16]
