"""The command line as a process and as a whole: exit codes, tracebacks, pipes, and packages that
are hidden."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import coview
import coview.commands.recordings.checks
from coview.main import COMMANDS
from toolkit.runtime.parallel import WorkLost
from toolkit.runtime.run import Run

SHELL = "import os, sys; os.execv('/bin/sh', ['sh', '-c', sys.argv[1], sys.executable])"
REPOSITORY = Path(coview.__file__).parents[1]


def process(*arguments, cwd, **options):
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, **options
    )


def test_version_and_help_name_every_command(run):
    assert run("--version") == (0, f"coview {coview.__version__}\n", "")
    code, out, _ = run("--help")
    assert code == 0
    assert all(name in out for name in COMMANDS)


@pytest.mark.parametrize("arguments", [(), ("fly",), ("survey", "--telepathy")])
def test_what_the_parser_refuses(arguments, run):
    assert run(*arguments)[0] == 2


@pytest.mark.parametrize(
    ("error", "code"),
    [
        *((ValueError("a rule, a value, a remedy"), 2), (FileNotFoundError("no such file"), 2)),
        (ImportError("traffic needs SUMO: pip install"), 3),
        (ModuleNotFoundError("No module named 'h5py'", name="h5py"), 3),
        (ImportError("cannot import name 'early'", name="toolkit.detection"), 70),
        *(
            (WorkLost("a worker process ended unexpectedly"), 4),
            (IndexError("list index out of range"), 70),
        ),
        *((RuntimeError("of a library"), 70), (KeyError("name"), 70), (KeyboardInterrupt(), 130)),
        (BrokenPipeError(), 141),
    ],
)
@pytest.mark.parametrize("debug", [False, True])
def test_an_error_by_its_type(error, code, debug, run, monkeypatch):
    def fail(dataset: str) -> int:
        raise error

    monkeypatch.setattr(coview.commands.recordings.checks, "doctor_command", fail)
    result, _, err = run("doctor", *["--debug"] * debug, "--dataset", "x")
    assert result == code
    assert ("Traceback" in err) == ((debug or code == 70) and code != 141)
    assert ("please report it" in err) == (code == 70)
    if code in (2, 3, 4):
        assert err.strip().splitlines()[-1] == f"coview: {error}"


def test_a_closed_pipe_ends_quietly(tmp_path):
    closed = (
        "import os, sys; r, w = os.pipe(); os.dup2(w, 1); os.close(w); os.close(r); from "
        "coview.main import main; "
    )
    for arguments in (["--help"], ["site", "show", "tjunction"]):
        done = process("-c", f"{closed} main({arguments!r})", cwd=tmp_path)
        assert (done.returncode, done.stderr) == (141, "")


def test_an_output_that_is_full_is_one_line(tmp_path):
    for arguments in ("--help", "survey --help", "site show tjunction"):
        done = process("-c", SHELL, f'exec "$0" -m coview {arguments} >/dev/full', cwd=tmp_path)
        assert (done.returncode, done.stderr) == (2, "coview: [Errno 28] No space left on device\n")


@pytest.mark.one_in(2)
@pytest.mark.parametrize("closed", ["<&- >&-", "2>&-", "<&- >&- 2>&-", "2>/dev/full"])
def test_streams_that_are_closed_or_full_change_no_code(closed, tmp_path):
    for arguments, code in (("--version", 0), ("site show tjunction", 0), ("site show nowhere", 2)):
        command = f'exec "$0" -m coview {arguments} {closed}'
        done = process("-c", SHELL, command, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (
            code,
            "" if "2>" in closed or not code else done.stderr,
        )


@pytest.mark.parametrize("name", ["models", "toolkit", "placement_env"])
def test_a_file_that_hides_a_package_is_named(name, tmp_path):
    hiding = tmp_path / f"{name}.py"
    hiding.write_text("def load(): ...\n")
    done = process("-m", "coview", "site", "show", "tjunction", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"coview: {hiding} hides {name}")
    assert done.stderr.count("\n") == 1


def test_what_a_dataclass_refuses_is_one_line(run, monkeypatch):
    def work(run: Run = Run()) -> int:
        print(run.workers)
        return 0

    monkeypatch.setattr("coview.main.command", lambda name: work)
    code, _, said = run("table", "--workers", "0")
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith("coview: workers must be a whole number of at least 1, got 0")
    assert run("table", "--workers", "many")[0] == 2
    assert run("table", "--workers", "2")[:2] == (0, "2\n")
