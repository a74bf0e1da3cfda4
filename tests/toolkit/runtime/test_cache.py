import hashlib
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import sqlite3
import stat
import subprocess
import sys
import time
import warnings
import zlib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.runtime.cache import CHECKSUM_BYTES, Cache, decode_arrays, encode_arrays, make_key

KEYS = [make_key("number", k) for k in range(40)]


def value(k):
    return np.full((k % 5, 3), k / 7), np.array([k], np.int16), np.zeros(0, bool)


def same(found, expected):
    return all(
        a.dtype == b.dtype and a.shape == b.shape and (a == b).all()
        for a, b in zip(found, expected, strict=True)
    )


@pytest.fixture
def cache(tmp_path):
    cache = Cache(tmp_path / "folder" / "cache.sqlite")
    cache.put({key: value(k) for k, key in enumerate(KEYS[:30])})
    return cache


def test_what_was_put_is_found_by_others_whose_files_stay(cache):
    for reader in (cache, Cache(cache.path), pickle.loads(pickle.dumps(cache))):
        found = reader.get(KEYS)
        assert all(same(each, value(k)) for k, each in enumerate(found[:30]))
        assert found[30:] == [None] * 10
        assert len(reader) == 30
    assert len(cache) == 30
    os.replace(cache.path, cache.path.with_name("aside"))
    other = Cache(cache.path)
    other.put({KEYS[0]: value(0)})
    cache._put_aside("damaged")
    assert len(other) == len(Cache(cache.path)) == 1


def test_many_keys_tell_apart_what_differs_and_is_kept(tmp_path):
    cache, keys = Cache(), [make_key(k) for k in range(1234)]
    cache.put({key: (np.array([k]),) for k, key in enumerate(keys[:-1])})
    found = cache.get(keys)
    assert [int(each[0][0]) for each in found[:-1] if each is not None] == list(range(1233))
    assert found[-1] is None
    assert cache.get([]) == []
    parts = [
        ("a",),
        ("a", 1),
        ("a", "1"),
        ("a", [1]),
        ("a", [1, 2]),
        ("a", 0.7),
        ("a", 0.7000000000000001),
        (["a"], 1),
    ]
    assert len({make_key(*each) for each in parts}) == len(parts)
    assert make_key({"b": 1, "a": 2}) == make_key({"a": 2, "b": 1})
    for column in (np.array([{}], object), np.zeros(1, [("a", "f4")])):
        with pytest.raises(ValueError, match="plain arrays"):
            Cache().put({KEYS[0]: (column,)})
    zeros = np.zeros((100_000, 3))
    assert len(encode_arrays(KEYS[0], [zeros])) < zeros.nbytes / 100
    assert same(
        decode_arrays(KEYS[0], encode_arrays(KEYS[0], [zeros, np.arange(5)])), (zeros, np.arange(5))
    )
    cache = Cache(tmp_path)  # a folder
    with pytest.warns(UserWarning, match="cannot be used"):
        cache.put({KEYS[0]: value(0)})
    with pytest.warns(UserWarning, match="cannot be used"):
        assert cache.get(KEYS[:1]) == [None]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 7))
def test_no_changed_bit_is_believed(place, bit):
    whole = encode_arrays(KEYS[0], value(3))
    changed = bytearray(whole)
    changed[place % len(whole)] ^= 1 << bit
    assert decode_arrays(KEYS[0], bytes(changed)) is None
    assert decode_arrays(KEYS[1], whole) is None
    assert decode_arrays(KEYS[0], whole[: place % len(whole)]) is None
    assert same(decode_arrays(KEYS[0], whole), value(3))


def sealed(head, content=b""):
    """A value whose checksum fits whatever it says."""
    body = json.dumps(head).encode() + b"\n" + content
    return hashlib.blake2b(body, digest_size=CHECKSUM_BYTES, key=KEYS[0]).digest() + body


@pytest.mark.parametrize(
    "value",
    [
        *(sealed([False, ["|O", [1]]], bytes(8)), sealed([False, ["i4,O", [1]]], bytes(12))),
        *(sealed([False, ["|V8", [1]]], bytes(8)), sealed([False, ["<f8", [-1]]], bytes(8))),
        *(
            sealed([False, ["<f8", [-1, -1]]], bytes(8)),
            sealed([False, ["<f8", [1 << 62]]], bytes(8)),
        ),
        *(
            sealed([False, ["<f8", [1 << 40, 0, 1 << 40]]]),
            sealed([True, ["<f8", [1 << 62]]], zlib.compress(bytes(8))),
        ),
        sealed([True, ["<f8", [1]]], zlib.compress(bytes(1 << 24))),
        *(sealed([True, ["<f8", [1]]], b"not compressed"), sealed([False, ["<f8", [2]]], bytes(8))),
        *(sealed([False, ["<f8", [1]]], bytes(16)), sealed([False, ["nothing", [1]]], bytes(8))),
        *(
            sealed([False, ["<f8"]], bytes(8)),
            sealed({"dtype": "<f8"}, bytes(8)),
            sealed([]),
            sealed(7),
            b"",
        ),
    ],
)
def test_what_is_no_plain_array_is_damaged_whatever_its_checksum_says(value):
    assert decode_arrays(KEYS[0], value) is None


def test_values_too_large_for_the_file_are_left_out(limits):
    limits("toolkit.runtime.cache", MAX_VALUE_BYTES=200)
    cache = Cache()
    with pytest.warns(UserWarning, match="1 values are too large"):
        cache.put({KEYS[0]: (np.arange(9),), KEYS[1]: (np.arange(900),)})
    assert [each is None for each in cache.get(KEYS[:2])] == [False, True]


def damage(path, kind):
    content = path.read_bytes()
    match kind:
        case "header":
            path.write_bytes(b"no database at all" * 400)
        case "short":
            path.write_bytes(content[:3000])
        case "pages":
            path.write_bytes(content[:100] + bytes(len(content) - 100))
        case "noise":
            noise = (
                np.random.default_rng(0).integers(0, 256, len(content) - 4096, np.uint8).tobytes()
            )
            path.write_bytes(content[:4096] + noise)


@pytest.mark.parametrize("kind", ["header", "short", "pages", "noise"])
def test_a_damaged_file_is_put_aside_and_begun_anew(cache, kind):
    cache.put({key: (np.random.default_rng(k).random(300),) for k, key in enumerate(KEYS)})
    cache.close()
    damage(cache.path, kind)
    again = Cache(cache.path)
    with pytest.warns(UserWarning, match="damaged"):
        found = again.get(KEYS)
    again.put({KEYS[0]: value(0)})
    assert all(
        each is None or same(each, (np.random.default_rng(k).random(300),))
        for k, each in enumerate(found)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert same(again.get(KEYS[:1])[0], value(0))
    assert any("damaged" in path.name for path in cache.path.parent.iterdir())


@pytest.mark.parametrize(
    "cell", ["'text'", "CAST(X'ff00fe' AS TEXT)", "7", "0.5", "X''", "zeroblob(99)"]
)
def test_a_row_of_any_kind_is_not_believed(cache, cell):
    cache.close()
    with sqlite3.connect(cache.path) as database:
        database.execute(f"UPDATE entries SET value = {cell} WHERE key = ?", KEYS[:1])
    database.close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = Cache(cache.path).get(KEYS[:2])
    assert found[0] is None
    assert same(found[1], value(1))


def test_only_who_knows_the_secret_writes_what_is_believed(cache, tmp_path):
    key = cache.path.with_name("cache.sqlite.key")
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    # knows the code and the keys of values, not the secret
    forger = Cache(tmp_path / "other" / "cache.sqlite")
    forger.put({KEYS[0]: value(9)})
    forger.close()
    cache.close()
    shutil.copy(forger.path, cache.path)
    assert Cache(cache.path).get(KEYS[:1]) == [None]
    cache.put({KEYS[0]: value(3)})
    assert same(Cache(cache.path).get(KEYS[:1])[0], value(3))
    content = key.read_bytes()
    for change in (lambda: key.chmod(0o640), lambda: key.write_bytes(content[:5])):
        key.unlink(missing_ok=True)
        key.write_bytes(content)
        key.chmod(0o600)
        assert Cache(cache.path).get(KEYS[:1]) != [None]
        change()
        with pytest.warns(
            UserWarning, match=r"cache.sqlite.key is not a secret of yours alone: remove it"
        ):
            assert Cache(cache.path).get(KEYS[:1]) == [None]
    key.unlink()
    os.mkfifo(key, 0o600)
    with pytest.warns(
        UserWarning, match=r"cache.sqlite.key is not a secret of yours alone: remove it"
    ):
        assert Cache(cache.path).get(KEYS[:1]) == [None]
    Cache(cache.path).delete()
    assert list(cache.path.parent.iterdir()) == []


def put_slowly(path, first, gate):
    gate.wait()
    cache = Cache(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(100):
            cache.put({make_key(first, k): (np.array([k]),), make_key("both", k): (np.array([k]),)})
            (kept,) = cache.get([make_key(first, k)])
            assert kept is not None
            assert kept[0] == k


def test_processes_share_a_file_that_none_of_them_has_made(tmp_path):
    context = multiprocessing.get_context("fork")
    gate = context.Barrier(4)
    path = tmp_path / "cache.sqlite"
    workers = [context.Process(target=put_slowly, args=(path, first, gate)) for first in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert [worker.exitcode for worker in workers] == [0] * 4
    assert len(Cache(path)) == 500


ENDLESS = """
import sys, numpy as np
from toolkit.runtime.cache import Cache, make_key
cache, k = Cache(sys.argv[1]), 0
while True:
    cache.put({make_key("pair", k, side): (np.full(5000, k),) for side in "ab"})
    k += 1
"""


def test_a_process_killed_in_mid_write_leaves_whole_values(tmp_path):
    path = tmp_path / "cache.sqlite"
    for _ in range(2):
        process = subprocess.Popen([sys.executable, "-c", ENDLESS, str(path)])
        while not path.exists() or len(Cache(path)) < 20:
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
        keys = [[make_key("pair", k, side) for k in range(5000)] for side in "ab"]
        a, b = (Cache(path).get(some) for some in keys)
        assert [each is None for each in a] == [each is None for each in b]
        assert all((each[0] == k).all() for k, each in enumerate(a) if each is not None)
