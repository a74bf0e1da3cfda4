"""Damages every file format in every way and counts: `python tests/mutations/run.py 1500` prints the table.

A reader may read a damaged file or refuse it with a ValueError or OSError of one line; it may do nothing else, take at
most 20 s, and leave the file as it is. Readers run in a process of their own, so that a crash is counted and named.
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

LONGEST = 20.0  # s that a reader may take
MEMORY = 24 << 30  # bytes that a process may map; a damaged file must not ask for the whole machine
Case = tuple[str, int]  # name of the format, number of the mutant


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mutants", type=int, nargs="?", default=400)
    parser.add_argument("--formats", nargs="*", help="part of the names of those wanted, all if not given")
    parser.add_argument("--number", type=int, help="only this mutant of each format, with its traceback")
    parser.add_argument("--worker", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker is not None:
        _work([(name, int(number)) for name, number in (case.rsplit(":", 1) for case in given.worker)])
        return
    cases = planned(given.mutants, given.formats)
    if given.number is not None:
        cases = [(name, given.number) for name in dict.fromkeys(name for name, _ in cases)]
    failures = examined(cases)
    print(table(cases, failures))
    for (name, number), why in failures.items():
        print(f"\n{name}:{number} {why}")
    sys.exit(bool(failures))


def planned(mutants: int, wanted: Sequence[str] | None = None) -> list[Case]:
    """At least so many mutants, shared out among the formats."""
    every = formats()
    each = mutants / sum(kind.share for kind in every.values())
    return [
        (name, number)
        for name, kind in every.items()
        if not wanted or any(part in name for part in wanted)
        for number in range(int(np.ceil(each * kind.share)))
    ]


def examined(cases: Sequence[Case]) -> dict[Case, str]:
    """Which cases fail and how, each read in another process, which is begun anew where it dies."""
    failures: dict[Case, str] = {}
    waiting = list(cases)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
    while waiting:
        names = [f"{name}:{number}" for name, number in waiting]
        with tempfile.TemporaryFile() as said:
            done = subprocess.run(
                [sys.executable, __file__, "--worker", *names],
                stdout=subprocess.PIPE,
                stderr=said,
                env=environment,
                check=False,
                cwd=Path(__file__).parents[2],
            )
            said.seek(0)
            last_words = said.read().decode(errors="replace")[-1500:]
        lines = [line for line in done.stdout.decode(errors="replace").splitlines() if line.startswith(("ok ", "no "))]
        for case, line in zip(waiting, lines, strict=False):
            if line.startswith("no "):
                failures[case] = line.removeprefix("no ").replace("\\n", "\n")
        if len(lines) < len(waiting):
            crashed = f"crash or hang, exit code {done.returncode}: {last_words}"
            failures[waiting[len(lines)]] = crashed
        waiting = waiting[len(lines) + 1 :]
    return failures


def table(cases: Iterable[Case], failures: Iterable[Case]) -> str:
    total, failed = (Counter(name for name, _ in some) for some in (cases, failures))
    rows = [f"| {name} | {count} | {count - failed[name]} | {failed[name]} |" for name, count in total.items()]
    whole, bad = sum(total.values()), sum(failed.values())
    head = ["| format | mutants | clean | failed |", "|---|---|---|---|"]
    return "\n".join([*head, *rows, f"| all | {whole} | {whole - bad} | {bad} |"])


def _work(cases: Sequence[Case]) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    every = formats()
    sound: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, number in cases:
            if name not in sound:
                every[name].make(Path(folder, name))
                every[name].read(Path(folder, name)) if name != "published.pth" else None
                sound[name] = Path(folder, name).read_bytes()
                Path(folder, name).unlink()
            print(_verdict(every[name], name, number, sound[name]).replace("\n", "\\n"), flush=True)


def _verdict(kind: Format, name: str, number: int, sound: bytes) -> str:
    rng = np.random.default_rng([crc32(name.encode()), number])
    mutation = kind.mutations[int(rng.integers(len(kind.mutations)))]
    what, content = mutation(sound, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(content)
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        try:
            kind.read(path)
        except (ValueError, OSError) as error:
            try:
                one_line(str(error))
            except RuntimeError as fault:
                return f"no {what}: {fault}"
        except BaseException:  # whatever it is, it is what is looked for
            return f"no {what}: {''.join(traceback.format_exc().splitlines(keepends=True)[-9:])}"
        finally:
            faulthandler.cancel_dump_traceback_later()
        same = [each.name for each in Path(folder).iterdir()] == [name] and path.read_bytes() == content
        if not (kind.owns or same):
            return f"no {what}: the file was touched, {hashlib.sha256(content).hexdigest()[:8]}"
    return f"ok {what}"


if __name__ == "__main__":
    main()
