"""The command line, run in this process, and a recording of four frames."""

import pytest

from coview.main import main


@pytest.fixture
def run(capsys):
    def run(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return stopped.value.code or 0, printed.out, printed.err

    return run


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "few.hdf5"
    with pytest.raises(SystemExit):
        main(
            [
                "simulate",
                "tjunction",
                "--frames",
                "4",
                "--seed",
                "3",
                "--out",
                str(path),
                "--workers",
                "1",
            ]
        )
    return path


@pytest.fixture
def refused(run):
    """Runs a command line that must be refused, in one line with exit code 2, and returns the
    line."""

    def refused(*arguments):
        code, _, err = run(*arguments)
        last = err.strip().splitlines()[-1]
        assert (code, last.startswith("coview: "), "Traceback" in err) == (2, True, False), err
        return last

    return refused
