import pytest

from toolkit.runtime.json_files import parse_json, read_json


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b'{"a": 1,\n', r"a\.json: not JSON from line 2 on"),
        (b"[" * 100_000, r"a\.json: its lists or objects are nested too deep"),
        (b'{"a":' * 100_000, "nested too deep"),
        (b"1" * 5000, "thousands of digits"),
        (b"\xff\xfe", r"a\.json: not a text file \(byte 0 is not UTF-8\)"),
    ],
)
def test_damage_is_one_line(tmp_path, content, says):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError, match=says) as error:
        read_json(tmp_path / "a.json")
    assert "\n" not in str(error.value)


def test_sound_json_is_read(tmp_path):
    (tmp_path / "a.json").write_text('\ufeff{"a": [1, 2.5, null]}', encoding="utf-8")
    assert read_json(tmp_path / "a.json") == parse_json('{"a": [1, 2.5, null]}') == {"a": [1, 2.5, None]}
