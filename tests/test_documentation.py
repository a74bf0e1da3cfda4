"""The documentation holds: its Python runs, its command lines parse, its links lead somewhere,
nothing is missing."""

import doctest
import functools
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import pytest
import tyro

from coview.main import COMMANDS, command
from coview.outputs import NOT_MET
from examples.studies.stress.conditions import KINDS

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
TEXTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *PAGES]
BLOCK = re.compile(r"(?:<!-- (minutes|file: \S+) -->\n)?```(\w*)\n(.*?)```", re.DOTALL)
CONFIG = (tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)


@pytest.fixture
def extension(work_in):
    """Import the modules of docs/ by name."""
    work_in(ROOT / "docs")
    return import_module


def blocks(page, language):
    return [
        (mark, text) for mark, found, text in BLOCK.findall(page.read_text()) if found == language
    ]


def name_of(page):
    return str(page.relative_to(ROOT))


def python_blocks(*, lasting):
    """Page and number of each block that takes minutes, or of each that does not."""
    numbered = [(page, number) for page in PAGES for number in range(len(blocks(page, "python")))]
    return [
        pytest.param(page, number, id=f"{name_of(page)}-{number}")
        for page, number in numbered
        if (blocks(page, "python")[number][0] == "minutes") == lasting
    ]


def run_block(page, number, folder, work_in):
    """Run a block with nothing but the files that its page shows."""
    work_in(folder)
    for mark, text in blocks(page, "python"):
        if mark.startswith("file: "):
            (folder / mark.removeprefix("file: ")).write_text(text)
    exec(
        compile(blocks(page, "python")[number][1], name_of(page), "exec"), {"__name__": "__main__"}
    )


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("page", "number"), python_blocks(lasting=False))
def test_a_python_block_runs_alone(page, number, tmp_path, work_in):
    run_block(page, number, tmp_path, work_in)


@pytest.mark.slow
@pytest.mark.parametrize(("page", "number"), python_blocks(lasting=True))
def test_a_python_block_of_minutes_runs_alone(page, number, tmp_path, work_in):
    run_block(page, number, tmp_path, work_in)


def command_lines(page):
    shown = "\n".join(
        text for language in ("", "console", "bash") for _, text in blocks(page, language)
    )
    lines = [line.removeprefix("$ ") for line in shown.replace("\\\n", " ").splitlines()]
    return [
        shlex.split(line, comments=True)[1:] for line in lines if re.match(r"coview [a-z]", line)
    ]


@functools.cache
def parsing(name):
    return functools.wraps(command(name))(lambda *_, **__: 0)


def refused(words):
    if words[0] not in COMMANDS:
        return "no such command"
    try:
        tyro.extras.subcommand_cli_from_dict(
            {words[0]: parsing(words[0])},
            prog="coview",
            args=words,
            config=CONFIG,
            console_outputs=False,
        )
    except SystemExit as stopped:
        return "" if "--help" in words and not stopped.code else "refused"
    return ""


@pytest.mark.parametrize("page", [page for page in TEXTS if command_lines(page)], ids=name_of)
def test_command_lines_parse(page):
    assert [" ".join(words) for words in command_lines(page) if refused(words)] == []


@pytest.mark.parametrize("page", TEXTS, ids=name_of)
def test_options_in_running_text_exist(page, extension):
    """Required arguments may be missing there, as in `coview evaluate --detector voxelnet`."""
    parser = extension("commands").parser
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for name, rest in re.findall(r"`coview ([a-z]+) ([^`]*--[^`]*)`", text):
        below = extension("commands").subcommands(parser(name)).values()
        known = {
            option for each in (parser(name), *below) for option in each._option_string_actions
        }
        assert set(re.findall(r"--[a-z0-9-]+", rest)) <= known, name


def test_commands_pictures_and_pages_are_where_readers_find_them():
    assert refused(["site", "show", "tjunction", "--out", "a.png"]) == ""
    assert [
        refused(words) for words in (["plan", "tjunction", "--bugdet", "4"], ["site", "shwo"])
    ] == ["refused"] * 2
    assert refused(["evalaute"]) == "no such command"
    assert set(COMMANDS) - {words[0] for page in TEXTS for words in command_lines(page)} <= {"demo"}
    most = {".png": 150_000, ".webp": 3_000_000}  # bytes of a picture, and of a film
    pictures = {path.resolve() for ending in most for path in (ROOT / "docs").rglob(f"*{ending}")}
    shown = {
        (page.parent / target).resolve()
        for page in TEXTS
        for target in re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text())
    }
    assert pictures == shown
    assert [path.name for path in pictures if path.stat().st_size > most[path.suffix]] == []
    tables = re.findall(
        r"```{toctree}(.*?)```", (ROOT / "docs" / "index.md").read_text(), re.DOTALL
    )
    listed = re.findall(r"^([\w/-]+)$", "\n".join(tables), re.MULTILINE)
    pages = [
        path
        for path in (ROOT / "docs").rglob("*")
        if path.suffix in (".md", ".rst", ".ipynb") and path.stem != "index"
    ]
    assert sorted(listed) == sorted(
        str(path.relative_to(ROOT / "docs").with_suffix("")) for path in pages
    )


def test_the_table_of_stress_has_every_kind():
    text = (ROOT / "docs" / "how-to" / "stress.md").read_text()
    rows = re.findall(r"^\| (`[a-z`, ]+`) \| ", text, re.MULTILINE)
    assert sorted(re.findall("[a-z]+", " ".join(rows))) == sorted(KINDS)


def anchors(page):
    headings = re.findall(
        r"^#+ (.*)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE
    )
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings
    }


@pytest.mark.parametrize("page", TEXTS, ids=name_of)
def test_links_lead_to_files_and_headings(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    links = {link for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link}
    for file, _, anchor in (link.partition("#") for link in links):
        target = page.parent / file if file else page
        assert target.exists(), file
        assert not anchor or anchor in anchors(target), f"{file}#{anchor}"


def lookup(dotted):
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            found = getattr(found, part, None)
        return found is not None
    return False


@pytest.mark.parametrize(
    "page", [page for page in TEXTS if page.name != "CHANGELOG.md"], ids=name_of
)
def test_names_and_files_in_running_text_exist(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    files = re.findall(
        r"\b(?:toolkit|models|placement_env|coview|tests|examples|docs)/[\w/]+\.\w+", text
    )
    places = (ROOT, ROOT / "tests" / "benchmarks")
    assert [file for file in files if not any((place / file).exists() for place in places)] == []
    names = re.findall(r"`((?:toolkit|models|placement_env|coview)(?:\.\w+)+)", text)
    assert [name for name in names if not lookup(name)] == []


@pytest.mark.slow
def test_pictures_are_drawn(tmp_path, work_in):
    work_in(ROOT / "docs" / "pictures")
    import_module("draw").main(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "directions.png",
        "error-profiles.png",
        "foreground.png",
    ]


@pytest.mark.parametrize("name", ["faces", "commands"])
def test_the_extensions_do_what_they_say(extension, name):
    tried = doctest.testmod(extension(name))
    assert tried.attempted > 0
    assert tried.failed == 0


@pytest.mark.parametrize("face", ["toolkit", "models", "placement_env"])
def test_the_reference_has_every_name_of_a_face(extension, face):
    lines = "\n".join(extension("faces").page(face))
    shown = re.findall(
        r"^\.\. (?:autoclass|autofunction|py:module):: \S+?\.(\w+)$", lines, re.MULTILINE
    )
    assert (
        sorted(set(shown) - {"search"}) == import_module(face).__all__
    )  # `search` of the methods, which are modules


def test_references_keep_docstrings_signatures_and_help(extension):
    text = (
        "Weights `w` * 2, `fuse` all_of | it_.\n\n    a  b\n    c\n\n1. one\n   more\n2. "
        "two\n\n>>> 1 + 1\n2"
    )
    words = r"Weights ``w`` \* 2, :py:obj:`fuse <toolkit.fuse>` all_of \| it\_."
    lines = "\n\n::\n\n    a  b\n    c\n\n1. one more\n2. two\n\n>>> 1 + 1\n2\n"
    assert extension("faces").as_rst(text) == (words + lines).split("\n")
    from toolkit import Body, Codec, crop

    signature = extension("faces").signature
    assert signature(crop).startswith(
        "(cloud: AnyCloud, area: Area, height: float | None = None, *, floor"
    )
    assert "vertices: Float32[np.ndarray, 'k 3']" in signature(Body)
    assert signature(Codec) == ""
    shown = list(extension("commands").section("site"))
    assert shown[0] == "coview site"
    assert [line for line in shown if line.startswith("coview site ")] >= [
        "coview site import",
        "coview site random",
    ]
    there = shown.index("``--centre FLOAT FLOAT``")
    assert (
        shown[there + 1]
        .strip()
        .startswith("Centre of the detection area: metres of an OpenDRIVE map")
    )
    assert "``SITE``" in shown
    assert "``--drop-invalid``" in list(extension("commands").section("evaluate"))


RUN = tomllib.loads(
    (Path(__file__).parent / "documented_commands.toml").read_text(encoding="utf-8")
)
SERVERS = ("live", "view")  # until they are stopped; `view` serves unless it writes
LONGEST_S = 900
STOPPED = 130  # exit code at Ctrl-C while the page is still being filled


def as_run(words):
    """Words of a shown command with the sizes and the reader's words of the table."""
    line = shlex.join(words)
    for shown, meant in RUN["words"].items():
        line = line.replace(shown, meant)
    sized = shlex.split(line)
    for option, value in RUN["sizes"].get(words[0], {}).items():
        if f"--{option}" not in sized:
            sized += [f"--{option}", value]
        elif "--random-sites" not in sized:
            sized[sized.index(f"--{option}") + 1] = value
    return sized


def is_left_out(words):
    return any(" ".join(words).startswith(line) for line in RUN["left_out"])


def written(words):
    """Paths that a command writes, as far as it says them."""
    options = {"--out", "--poses"} if words[0] == "calibrate" else {"--out"}
    return {path for option, path in pairwise(words) if option in options}


def serves(words):
    return words[0] in SERVERS and not {"--out", "--still"} & set(words)


def lacking(words, folder):
    """Files of the table that a command reads and its folder does not have."""
    read = set(words) - written(words)
    named = [
        name
        for name in RUN["files"]
        if any(word == name or word.startswith(f"{name}/") for word in read)
    ]
    return [name for name in named if not (folder / name).exists()]


def start(arguments, folder):
    """A Python process in a folder, which is not on its path, that opens no browser and ends at
    Ctrl-C."""
    return subprocess.Popen(
        [sys.executable, "-P", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "BROWSER": "true"},
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # which a shell's background ignores
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ending(process, well=(0,)):
    """How a process ended, "" for well."""
    try:
        said, _ = process.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return f"not done after {LONGEST_S} s"
    return "" if process.returncode in well else f"exit code {process.returncode}: {said[-2000:]}"


def outcome(arguments, folder):
    # with so few frames and so little money the answer may be no, which is an answer
    codes = (0, NOT_MET) if "--min-ap" in arguments else (0,)
    return ending(start(arguments, folder), codes)


def outcome_of_server(arguments, folder):
    """Outcome of a server that is stopped, as by Ctrl-C, when it has printed its address."""
    process = start(arguments, folder)
    for line in process.stdout:
        if "http://127.0.0.1" in line:
            process.send_signal(signal.SIGINT)
            return ending(process, (0, STOPPED))
    return f"ended by itself with exit code {process.wait()}"


@pytest.fixture(scope="session")
def taken_for_granted(tmp_path_factory):
    """Give a folder one of the files of the table, made when it is first asked for."""
    store = tmp_path_factory.mktemp("taken-for-granted")

    def copy(source, target):
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, target)

    def make(name):
        if (store / name).exists():
            return
        ((way, source),) = RUN["files"][name].items()
        if way == "text":
            (store / name).write_text(source)
        elif way == "block":
            (store / name).write_text(blocks(ROOT / source, "toml")[0][1])
        elif way == "copy":
            for needed in lacking(["", source], store):
                if needed != name:
                    make(needed)
            copy(store / source if (store / source).exists() else ROOT / source, store / name)
        else:
            words = shlex.split(source) if way == "command" else ["my-junction"]
            for needed in lacking(words, store):
                make(needed)
            arguments = ("-m", "coview", *words) if way == "command" else ("-c", source)
            assert outcome(arguments, store) == "", name

    def give(name, folder):
        make(name)
        copy(store / name, folder / name)
        if name == "catalogue.toml":
            give("elm.png", folder)

    return give


RUN_PAGES = [page for page in (TEXTS[0], *PAGES) if command_lines(page)]


def test_the_table_of_commands_has_nothing_that_no_page_shows(tmp_path):
    shown = [words for page in RUN_PAGES for words in command_lines(page)]
    lines = [shlex.join(words) for words in shown]
    assert [words for words in RUN["words"] if not any(words in line for line in lines)] == []
    assert [
        line for line in RUN["left_out"] if not any(shown.startswith(line) for shown in lines)
    ] == []
    assert {words[0] for words in shown} >= RUN["sizes"].keys()
    sources = [
        ["", *str(source).split()] for way in RUN["files"].values() for source in way.values()
    ]
    used = {name for words in [*map(as_run, shown), *sources] for name in lacking(words, tmp_path)}
    assert RUN["files"].keys() - used == {"elm.png"}  # of a page's catalogue


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN_PAGES, ids=name_of)
def test_commands_of_a_page_run_in_their_order(page, tmp_path, taken_for_granted):
    """A path that an earlier command of the page wrote is taken away first: the two are
    alternatives."""
    for mark, text in blocks(page, "python"):
        if mark.startswith("file: "):
            (tmp_path / mark.removeprefix("file: ")).write_text(text)
    outcomes = {}
    for words in map(as_run, command_lines(page)):
        if is_left_out(words):
            continue
        for name in lacking(words, tmp_path):
            taken_for_granted(name, tmp_path)
        for path in map(tmp_path.joinpath, written(words)):
            if path.exists():
                (shutil.rmtree if path.is_dir() else Path.unlink)(path)
        run = outcome_of_server if serves(words) else outcome
        line, start_s = shlex.join(words), time.monotonic()
        outcomes[line] = run(("-m", "coview", *words), tmp_path)
        print(f"{time.monotonic() - start_s:6.0f} s  coview {line}\n{outcomes[line]}", flush=True)
    assert [line for line, said in outcomes.items() if said] == []
