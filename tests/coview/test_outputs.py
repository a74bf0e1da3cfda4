"""Where a command may write, and what it prints."""

import ast
from functools import partial
from pathlib import Path

import pytest

import coview
from coview.outputs import check_file, check_folder, claim, find_kind, report, say


def test_what_steers_a_terminal_is_shown_and_not_done(capsys):
    say("a\x1b]0;title\x07 b\u202e c\x9b2J d\udcff e\r f\x7f\n\tStra\u00dfe \u4e2d \U0001f600")
    report(ValueError("no sensor \x1b[2Jnorth"))
    printed = capsys.readouterr()
    assert (
        printed.out
        == r"a\x1b]0;title\x07 b\u202e c\x9b2J d\udcff e\r f\x7f"
        + "\n\tStra\u00dfe \u4e2d \U0001f600\n"
    )
    assert printed.err == "coview: no sensor \\x1b[2Jnorth\n"


def test_commands_print_through_one_function():
    for path in sorted((Path(coview.__file__).parent / "commands").rglob("*.py")):
        calls = [
            node.func
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call)
        ]
        assert "print" not in {call.id for call in calls if isinstance(call, ast.Name)}, path


def test_what_may_be_written_and_what_may_not(tmp_path):
    check_file(None)
    check_file(tmp_path / "new" / "folder" / "file.ply")
    check_folder(tmp_path / "new", holds="table.json")
    (tmp_path / "other").write_text("")
    check_folder(tmp_path, holds="table.json")  # other files in it do not matter
    check_file(tmp_path / "other", overwrite=True)
    assert [each.name for each in tmp_path.iterdir()] == ["other"]
    (tmp_path / "there").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    for out in (tmp_path / "there", tmp_path / "link"):
        with pytest.raises(FileExistsError, match="--overwrite"):
            check_file(out)
        with pytest.raises(ValueError, match="is what is read"):
            check_file(out, inputs=[tmp_path / "there"], overwrite=True)
    with pytest.raises(NotADirectoryError, match="give another path"):
        check_file(tmp_path / "there" / "below", overwrite=True)
    with pytest.raises(IsADirectoryError, match="is a folder"):
        check_file(tmp_path, overwrite=True)
    with pytest.raises(FileExistsError):
        check_folder(tmp_path, holds="there")


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        ('{"map_SE3_site": []}', "a site's file"),
        ('{"coview_plan": 1}', "a plan"),
        ('{"coview_live": 1}', "a project of coview live"),
        ('{"decoded": false}', "the card of a network"),
    ],
)
def test_overwrite_replaces_only_what_the_same_command_makes(tmp_path, content, kind):
    path = tmp_path / "junction.json"
    path.write_text(content)
    assert find_kind(path) == kind
    for overwrite in (False, True):
        with pytest.raises(
            ValueError, match=f"junction.json is {kind}, which this command does not write"
        ):
            check_file(path, overwrite=overwrite)
    with pytest.raises(FileExistsError, match="--overwrite"):
        check_file(path, kind=kind)
    check_file(path, overwrite=True, kind=kind)


@pytest.mark.parametrize("content", ["{", "[1]", "{}", '"map_SE3_site"'])
def test_files_of_no_known_kind_are_replaced_when_told(tmp_path, content):
    path = tmp_path / "boxes.json"
    path.write_text(content)
    assert find_kind(path) == ""
    check_file(path, overwrite=True)
    assert find_kind(tmp_path / "none.json") == ""


def test_a_folder_with_a_strangers_file_is_not_replaced(tmp_path):
    (tmp_path / "site.json").write_text('{"map_SE3_site": []}')
    check = partial(
        check_folder, tmp_path, holds="plan.json", writes=("plan.json", "site.json"), kind="a plan"
    )
    with pytest.raises(ValueError, match=r"site.json is what is read"):
        check(inputs=[tmp_path / "site.json"], overwrite=True)
    with pytest.raises(
        ValueError, match=r"holds site.json, which this command did not write, as there is no plan"
    ):
        check(overwrite=True)
    (tmp_path / "plan.json").write_text('{"coview_plan": 1}')
    check(overwrite=True)
    with pytest.raises(ValueError, match=r"site.json is what is read"):
        check(inputs=[tmp_path / "site.json"], overwrite=True)
    with pytest.raises(FileExistsError, match="--overwrite"):
        check()


def test_folders_that_may_not_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr("coview.outputs.os.access", lambda *_: False)
    with pytest.raises(PermissionError, match="may not be written"):
        check_file(tmp_path / "file")


def test_a_stopped_run_may_replace_its_own_files_and_nobody_writes_beside_it(tmp_path):
    out = tmp_path / "out"
    check = partial(check_folder, out, holds="rows.json")

    def run(asked, error=None, writes=True, overwrite=False):
        with claim(out, asked, check, overwrite=overwrite) as again:
            with (
                pytest.raises(FileExistsError, match="another run is writing"),
                claim(out, asked, check),
            ):
                pass
            if writes:
                out.mkdir(exist_ok=True)
                (out / "rows.json").write_text(f"{asked}")
            if error:
                raise error
            return again

    with pytest.raises(ValueError, match="mine"):
        run("first", ValueError("mine"), writes=False)
    assert not list(tmp_path.iterdir())
    with pytest.raises(KeyboardInterrupt):
        run("first", KeyboardInterrupt())
    with pytest.raises(FileExistsError, match="--overwrite"):
        run("another")
    assert run("first")
    assert [each.name for each in tmp_path.iterdir()] == ["out"]
    with pytest.raises(FileExistsError, match="--overwrite"):  # finished
        run("first")
    assert run("another", overwrite=True)
    assert [each.name for each in tmp_path.iterdir()] == ["out"]
