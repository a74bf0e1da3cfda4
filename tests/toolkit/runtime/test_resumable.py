import errno
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from toolkit.runtime.resumable import ShardFolder, describe_differences, make_shards
from toolkit.runtime.writing import UNFINISHED

REPOSITORY = Path(__file__).parents[3]

SCRIPT = """
import random, sys, time
from pathlib import Path
from toolkit.runtime.resumable import ShardFolder, make_shards

class Letters:
    def start(self, threads):
        return self.letters

    def letters(self, block):
        for _ in range(5):
            time.sleep(0.002)
            yield chr(97 + block)

    def encode(self, items):
        return "".join(items).encode() * 100_000

def join(paths, target):
    with target.open("wb") as file:
        for path in paths:
            file.write(path.read_bytes())
            file.flush()

if __name__ == "__main__":
    out, workers = Path(sys.argv[1]), int(sys.argv[2])
    parts = ShardFolder(out.with_name(out.name + ".parts"), {"letters": 12})
    with parts.lock():
        parts.open(False)
        safe = parts.check_shards()
        make_shards(Letters(), parts, [b for b in range(12) if b not in safe], workers=workers, progress=lambda n: None)
        parts.publish(out, join)
"""


@pytest.fixture
def run(tmp_path):
    script = tmp_path / "letters.py"
    script.write_text(SCRIPT)

    def start(out: Path, workers: int) -> subprocess.Popen:
        return subprocess.Popen(
            [sys.executable, str(script), str(out), str(workers)],
            env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
            start_new_session=True,
            stderr=subprocess.PIPE,
            text=True,
        )

    return start


def complete(out: Path, run, workers: int) -> bytes:
    process = run(out, workers)
    assert process.wait() == 0, process.stderr.read()
    assert not out.with_name(out.name + ".parts").exists()
    return out.read_bytes()


@pytest.mark.parametrize("workers", [1, 2])
def test_killed_at_any_moment_it_ends_with_the_same_bytes(tmp_path, run, workers):
    undisturbed = complete(tmp_path / "undisturbed", run, 1)
    assert undisturbed == b"".join(letter.encode() * 500_000 for letter in "abcdefghijkl")
    out = tmp_path / "disturbed"
    moment = random.Random(workers)
    for _ in range(12 if workers == 1 else 6):
        process = run(out, workers)
        time.sleep(moment.uniform(0.05, 0.6))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert not out.exists() or out.read_bytes() == undisturbed
        if out.exists():
            break
    if out.exists():
        assert out.read_bytes() == undisturbed
    else:
        assert complete(out, run, workers) == undisturbed


def test_workers_end_with_their_parent(tmp_path, run):
    process = run(tmp_path / "out", 2)
    group = os.getpgid(process.pid)
    time.sleep(0.4)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.killpg(group, signal.SIGKILL)
    pytest.fail("workers outlived their parent by five seconds")


def folder(tmp_path, **plan):
    made = ShardFolder(tmp_path / "f.parts", plan or {"seed": 1})
    made.path.mkdir(parents=True, exist_ok=True)
    made.open(False)
    return made


def test_damaged_parts_go_and_others_files_stay(tmp_path):
    parts = folder(tmp_path)
    for block in range(4):
        parts.add(block, bytes([block]) * 1000)
    paths = parts.shards()
    paths[1].write_bytes(paths[1].read_bytes()[:500])
    paths[2].write_bytes(b"x" + paths[2].read_bytes()[1:])
    (parts.path / "00004.00000000.hdf5.123.unfinished").write_bytes(b"half")
    assert sorted(parts.check_shards()) == [0, 3]
    assert len(list(parts.path.iterdir())) == 3
    parts = folder(tmp_path / "own")
    (parts.path / "notes.txt").write_text("mine")
    assert parts.check_shards() == {}
    parts.remove()
    assert [path.name for path in parts.path.iterdir()] == ["notes.txt"]
    with pytest.raises(ValueError, match="at least 1, got 0"):
        make_shards(
            Nothing(), folder(tmp_path / "none"), [0], workers=0, progress=lambda done: None
        )
    assert describe_differences({"a": 1}, {"a": 1}) == ""
    assert (
        describe_differences({"a": 1, "b": 2}, {"a": 1, "c": 3})
        == "b 2 instead of None, c None instead of 3"
    )


def test_plans_are_the_runs_own_one_at_a_time(tmp_path):
    folder(tmp_path, seed=1, site="a").add(0, b"1")
    other = ShardFolder(tmp_path / "f.parts", {"seed": 2, "site": "a"})
    with pytest.raises(
        FileExistsError, match="made from seed 1 instead of 2: finish that one first"
    ):
        other.open(False)
    assert len(other.shards()) == 1
    other.open(True)
    assert other.shards() == {}
    parts = folder(tmp_path / "own")
    parts.add(0, b"1")
    (parts.path / "plan.json").write_text("{")
    parts.open(False)
    assert parts.shards() == {}
    parts = folder(tmp_path / "locked")
    with parts.lock(), pytest.raises(FileExistsError, match="another run is writing"), parts.lock():
        pass
    with parts.lock():
        pass


def test_another_plan_may_take_a_folder_in_which_nothing_was_finished(tmp_path):
    folder(tmp_path, seed=1)
    other = ShardFolder(tmp_path / "f.parts", {"seed": 2})
    (other.path / f"00000{UNFINISHED}").write_bytes(b"1")
    with other.lock():
        other.open(False)
    assert other.found == {"seed": 2}
    assert other.shards() == {}


def test_a_lock_leaves_shards_only(tmp_path):
    parts = ShardFolder(tmp_path / "empty.parts", {"seed": 1})
    with parts.lock():
        assert parts.path.is_dir()
    assert not parts.path.exists()
    parts = folder(tmp_path)
    with parts.lock():
        parts.add(0, b"1")
    # 83dcefb7 is the CRC-32 of the character 1
    assert sorted(path.name for path in parts.path.iterdir()) == [
        "00000.83dcefb7.hdf5",
        "plan.json",
    ]


def test_a_full_disk_says_what_is_safe(tmp_path):
    parts = folder(tmp_path)
    parts.add(0, b"1")
    says = r"cannot write out: No space left on device \(\d+ MB free\); 50 frames are safe in .*f.parts, make room and"
    with (
        pytest.raises(OSError, match=says),
        parts.explain_disk_errors(Path("out"), lambda p: 50 * len(list(p))),
    ):
        raise OSError(errno.ENOSPC, "full")
    with pytest.raises(RuntimeError, match="other"), parts.explain_disk_errors(Path("out"), len):
        raise RuntimeError("other")


class Nothing:
    def start(self, threads):
        return lambda block: iter(())

    def encode(self, items):
        return b""
