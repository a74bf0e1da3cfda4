"""Damages every file format in every way and counts: `python tests/mutations/run.py 1500` prints
the table.

With `--structured` the damage knows the format; `--read` lists what was read all the same; `--seed`
draws other mutants. With `--places` something that is no file is in the place of each, and must be
refused. A reader may read a damaged file or refuse it with a ValueError or OSError of one line; it
may do nothing else, take at most 20 s and 2 GB, and must leave the file as it is. Readers run in a
process of their own, so that a crash is counted and named.
"""

import argparse
import faulthandler
import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from zlib import crc32

import numpy as np
from formats import Format, formats, one_line

from toolkit.runtime import reading

LONGEST = 20.0  # s that a reader may take
MAPPED = 24 << 30  # bytes that a process may map; a damaged file must not ask for the whole machine
MEMORY = 2 << 30  # bytes that reading one file may take
PLACES = ("pipe", "folder", "/dev/zero", "/no/where", "loop")
Case = tuple[str, int]  # name of the format, number of the mutant


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mutants", type=int, nargs="?", default=400)
    parser.add_argument(
        "--formats", nargs="*", help="part of the names of those wanted, all if not given"
    )
    parser.add_argument(
        "--number", type=int, help="only this mutant of each format, with its traceback"
    )
    parser.add_argument("--structured", action="store_true", help="damage that knows the format")
    parser.add_argument(
        "--places", action="store_true", help="pipes, folders, devices and lost links for files"
    )
    parser.add_argument("--seed", type=int, default=0, help="draw other mutants")
    parser.add_argument("--read", action="store_true", help="list what was read all the same")
    parser.add_argument("--worker", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker is not None:
        cases = [
            (name, int(number)) for name, number in (case.rsplit(":", 1) for case in given.worker)
        ]
        _work(cases, given.structured, given.seed, given.places)
        return
    cases = planned(given.mutants, given.formats, given.structured)
    if given.places:
        cases = [(name, number) for name in dict(cases) for number in range(len(PLACES))]
    if given.number is not None:
        cases = [(name, given.number) for name in dict.fromkeys(name for name, _ in cases)]
    mode = ["--structured"] * given.structured + ["--places"] * given.places
    failures, read = examined(cases, [*mode, "--seed", str(given.seed)])
    print(table(cases, failures))
    for name, what in sorted(read) if given.read else ():
        print(f"read: {name}: {what}")
    for (name, number), why in failures.items():
        print(f"\n{name}:{number} {why}")
    sys.exit(bool(failures))


def planned(
    mutants: int, wanted: Sequence[str] | None = None, structured: bool = False
) -> list[Case]:
    """At least so many mutants, shared out among the formats, those that damage knows where
    `structured`."""
    every = {name: kind for name, kind in formats().items() if kind.structured or not structured}
    each = mutants / sum(kind.share for kind in every.values())
    return [
        (name, number)
        for name, kind in every.items()
        if not wanted or any(part in name for part in wanted)
        for number in range(int(np.ceil(each * kind.share)))
    ]


def examined(
    cases: Sequence[Case], option: Sequence[str]
) -> tuple[dict[Case, str], list[tuple[str, str]]]:
    """Which cases fail and how, each read in another process, which is begun anew where it dies;
    what was read."""
    failures: dict[Case, str] = {}
    read: list[tuple[str, str]] = []
    waiting = list(cases)
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[2]),
        "OMP_NUM_THREADS": "1",
    }
    while waiting:
        names = [f"{name}:{number}" for name, number in waiting]
        with tempfile.TemporaryFile() as said:
            done = subprocess.run(
                [sys.executable, __file__, *option, "--worker", *names],
                stdout=subprocess.PIPE,
                stderr=said,
                env=environment,
                check=False,
                cwd=Path(__file__).parents[2],
            )
            said.seek(0)
            last_words = said.read().decode(errors="replace")[-1500:]
        lines = [
            line
            for line in done.stdout.decode(errors="replace").splitlines()
            if line.startswith(("ok ", "no "))
        ]
        for case, line in zip(waiting, lines, strict=False):
            if line.startswith("ok read "):
                read.append((case[0], line.removeprefix("ok read ")))
            if line.startswith("no "):
                failures[case] = line.removeprefix("no ").replace("\\n", "\n")
        if len(lines) < len(waiting):
            crashed = f"crash or hang, exit code {done.returncode}: {last_words}"
            failures[waiting[len(lines)]] = crashed
        waiting = waiting[len(lines) + 1 :]
    return failures, read


def table(cases: Iterable[Case], failures: Iterable[Case]) -> str:
    total, failed = (Counter(name for name, _ in some) for some in (cases, failures))
    rows = [
        f"| {name} | {count} | {count - failed[name]} | {failed[name]} |"
        for name, count in total.items()
    ]
    whole, bad = sum(total.values()), sum(failed.values())
    head = ["| format | mutants | clean | failed |", "|---|---|---|---|"]
    return "\n".join([*head, *rows, f"| all | {whole} | {whole - bad} | {bad} |"])


def _work(cases: Sequence[Case], structured: bool, seed: int, in_place: bool) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MAPPED, MAPPED))
    every = formats()
    sound: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, number in cases:
            if name not in sound:
                every[name].make(Path(folder, name))
                every[name].read(Path(folder, name)) if name != "published.pth" else None
                sound[name] = Path(folder, name).read_bytes()
                Path(folder, name).unlink()
            if in_place:
                verdict = _place_verdict(every[name], name, PLACES[number])
            else:
                verdict = _verdict(every[name], name, number, sound[name], structured, seed)
            print(verdict.replace("\n", "\\n"), flush=True)


def _verdict(
    kind: Format, name: str, number: int, sound: bytes, structured: bool, seed: int
) -> str:
    rng = np.random.default_rng([crc32(name.encode()), number, *([seed] if seed else [])])
    mutations = kind.structured if structured else kind.mutations
    mutation = mutations[int(rng.integers(len(mutations)))]
    what, content = mutation(sound, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(content)
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        before, read = peak(), ""
        try:
            kind.read(path)
            read = "read "
        except (ValueError, OSError) as error:
            try:
                one_line(str(error))
            except RuntimeError as fault:
                return f"no {what}: {fault}"
        except BaseException:  # whatever it is, it is what is looked for
            return f"no {what}: {''.join(traceback.format_exc().splitlines(keepends=True)[-9:])}"
        finally:
            faulthandler.cancel_dump_traceback_later()
        if (more := peak() - before) > MEMORY:
            return f"no {what}: took {more / 1e9:.1f} GB"
        same = [each.name for each in Path(folder).iterdir()] == [
            name
        ] and path.read_bytes() == content
        if not (kind.owns or same):
            return f"no {what}: the file was touched, {hashlib.sha256(content).hexdigest()[:8]}"
    return f"ok {read}{what}"


def _place_verdict(kind: Format, name: str, what: str) -> str:
    reading.MAX_SILENCE_S = 0.1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        if what in ("pipe", "folder"):
            (os.mkfifo if what == "pipe" else os.mkdir)(path)
        else:
            path.symlink_to(path if what == "loop" else what)
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        try:
            kind.read(path)
        except (ValueError, OSError) as error:
            try:
                one_line(str(error))
            except RuntimeError as fault:
                return f"no {what}: {fault}"
            return f"ok {what}"
        except BaseException:
            return f"no {what}: {''.join(traceback.format_exc().splitlines(keepends=True)[-9:])}"
        finally:
            faulthandler.cancel_dump_traceback_later()
    return f"{'ok' if kind.owns else 'no'} {what}: it was read"


def peak() -> int:
    """Most bytes of memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    main()
