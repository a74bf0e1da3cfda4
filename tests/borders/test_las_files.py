"""LAS and LAZ: numbers packed by hand by the standard's tables, and files that laspy writes."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from toolkit.clouds import attributes
from toolkit.datasets.cloud_files import fuse_files, read_points, read_recorded
from toolkit.datasets.problem_kinds import EMPTY
from toolkit.datasets.recordings import open_recording

laspy = pytest.importorskip("laspy")

SCALES = (0.01, 0.001, 0.1)
OFFSETS = (692000.0, 5336000.0, 500.0)
WHOLE = np.array([[-100, 5, 7], [250, -2000, 0], [0, 0, -31]])


def packed(whole=WHOLE, scales=SCALES, offsets=OFFSETS, count=None, records=b"") -> bytes:
    """LAS 1.2, point format 0, from the tables of its specification."""
    rows = [
        struct.pack("<3iHBBbBH", *row, 1000 + k, 9, 2, -5, 1, 77) for k, row in enumerate(whole)
    ]
    with np.errstate(all="ignore"):
        points = np.array(whole) * scales + offsets
    low, high = points.min(axis=0), points.max(axis=0)
    bounds = [value for pair in zip(high, low, strict=True) for value in pair]
    number = len(rows) if count is None else count
    header = struct.pack(
        "<4sHHIHH8sBB32s32sHH", b"LASF", 0, 0, 0, 0, 0, b"", 1, 2, b"", b"", 1, 2026
    )
    header += struct.pack(
        "<HIIBHI5I", 227, 227 + len(records), bool(records), 0, 20, number, number, 0, 0, 0, 0
    )
    header += struct.pack("<12d", *scales, *offsets, *bounds)
    assert len(header) == 227
    return header + records + b"".join(rows)


def with_number(content: bytes, byte: int, form: str, number: int) -> bytes:
    """A file with another number at a byte."""
    changed = bytearray(content)
    struct.pack_into(form, changed, byte, number)
    return bytes(changed)


def record(kind: int, content: bytes) -> bytes:
    """A variable length record of LASF_Projection."""
    return struct.pack("<H16sHH32s", 0, b"LASF_Projection", kind, len(content), b"") + content


def test_numbers_packed_by_hand(tmp_path):
    (tmp_path / "a.las").write_bytes(packed())
    found = read_recorded(tmp_path / "a.las")
    np.testing.assert_allclose(found["positions"], WHOLE * SCALES + OFFSETS, rtol=0, atol=1e-9)
    assert found["intensity"].ravel().tolist() == [1000, 1001, 1002]
    assert found["classification"].ravel().tolist() == [2, 2, 2]
    assert found["point_source_id"].ravel().tolist() == [77] * 3


@pytest.mark.parametrize("ending", [".las", ".laz"])
@pytest.mark.parametrize("form", [0, 3, 7])
def test_what_laspy_writes(tmp_path, form, ending):
    if ending == ".laz":
        pytest.importorskip("lazrs")
    rng = np.random.default_rng(form)
    header = laspy.LasHeader(point_format=form, version="1.4" if form > 5 else "1.2")
    header.scales, header.offsets = np.array([1e-3] * 3), np.array(OFFSETS)
    written = laspy.LasData(header)
    points = rng.uniform(-40, 40, (500, 3)) + OFFSETS
    written.x, written.y, written.z = points.T
    written.intensity = rng.integers(0, 60000, 500)
    if form:
        written.gps_time = np.linspace(3e5, 3e5 + 80, 500)
        written.red = rng.integers(0, 65536, 500)
    written.write(tmp_path / f"a{ending}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_recorded(tmp_path / f"a{ending}")
    np.testing.assert_allclose(found["positions"], points, rtol=0, atol=5.001e-4)
    np.testing.assert_array_equal(found["intensity"].ravel(), written.intensity)
    if form:
        np.testing.assert_array_equal(found["gps_time"].ravel(), written.gps_time)
        np.testing.assert_array_equal(found["colors"][:, 0], np.asarray(written.red) >> 8)


def test_a_folder_of_tiles_is_a_recording(tmp_path):
    (tmp_path / "north").mkdir()
    (tmp_path / "north" / "000000.las").write_bytes(packed())
    (frame,) = list(open_recording(tmp_path))
    np.testing.assert_allclose(frame.points(), WHOLE * SCALES + OFFSETS, rtol=0, atol=1e-3)
    assert frame.clouds[0].intensity.tolist() == [1000, 1001, 1002]


def test_scans_fuse(tmp_path):
    for name in ("a.las", "b.las"):
        (tmp_path / name).write_bytes(packed())
    fused = attributes(fuse_files([tmp_path / "a.las", tmp_path / "b.las"], [np.eye(4)] * 2))
    assert len(fused["positions"]) == 6


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it is empty"),
        (b"PK\3\4" + bytes(400), "does not begin with LASF"),
        (packed()[:150], "cut off in its header"),
        (packed()[:-20], "cut off: 3 points of 20 bytes begin at byte 227, but it has 267"),
        (packed()[:-7], "cut off"),
        (with_number(packed(), 94, "<H", 9999), "header is said to have 9999 bytes"),
        (with_number(packed(), 96, "<I", 10**9), "points to begin at byte 1000000000"),
        (with_number(packed(), 100, "<I", 2**32 - 1), "4294967295 records are said to be"),
        (packed(count=2**31), "unpacks to 40.0 GiB"),
        (packed(scales=(0.01, 0.0, 0.1)), r"scales must be finite and scales positive, got \[0.01"),
        (packed(scales=(0.01, float("nan"), 0.1)), "scales must be finite"),
        (packed(offsets=(float("inf"), 0, 0)), "offsets must be finite"),
        (packed(records=record(2112, b'GEOGCS["WGS 84",UNIT["degree",0.017]]\0')), "degrees"),
        (
            packed(
                records=record(2112, b'PROJCS["Ohio",GEOGCS["x"],UNIT["US survey foot",0.3]]\0')
            ),
            "not in metres",
        ),
        (packed(records=record(34735, struct.pack("<8H", 1, 1, 0, 1, 1024, 0, 1, 2))), "degrees"),
        (
            packed(records=record(34735, struct.pack("<8H", 1, 1, 0, 1, 3076, 0, 1, 9003))),
            "not in metres",
        ),
    ],
)
def test_damage_is_named(tmp_path, content, reason):
    path = tmp_path / "a.las"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=reason) as raised:
        read_recorded(path)
    assert str(path) in str(raised.value)


def test_a_projected_system_in_metres_passes(tmp_path):
    text = b'PROJCS["UTM 32N",GEOGCS["WGS 84",UNIT["degree",0.0174]],UNIT["metre",1]]\0'
    keys = struct.pack("<12H", 1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9001)
    for number, records in enumerate((record(2112, text), record(34735, keys))):
        (tmp_path / f"{number}.las").write_bytes(packed(records=records))
        assert len(read_points(tmp_path / f"{number}.las")) == 3


def test_damaged_laz_is_named(tmp_path):
    pytest.importorskip("lazrs")
    path = tmp_path / "a.laz"
    laspy.LasData(laspy.LasHeader()).write(path)
    header = laspy.LasHeader()
    written = laspy.LasData(header)
    written.x = written.y = written.z = np.arange(3000.0)
    written.write(path)
    whole = path.read_bytes()
    for content in (whole[:-60], whole[: len(whole) // 2], whole[:300]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.laz holds no points that can be read"):
            read_recorded(path)


def test_a_file_of_no_points_is_an_empty_cloud(tmp_path):
    (tmp_path / "north").mkdir()
    laspy.LasData(laspy.LasHeader()).write(tmp_path / "north" / "000000.las")
    (frame,) = list(open_recording(tmp_path))
    assert len(frame.points()) == 0
    assert frame.problems == {EMPTY: 1}


def test_withheld_points_bounds_and_colours_of_bytes_are_warned_of(tmp_path):
    header = laspy.LasHeader(point_format=2)
    written = laspy.LasData(header)
    written.x = written.y = written.z = np.arange(5.0)
    written.withheld = [0, 1, 0, 0, 1]
    written.red = [1, 2, 3, 4, 255]
    written.write(tmp_path / "a.las")
    with pytest.warns(UserWarning, match="points are flagged") as warned:
        found = read_recorded(tmp_path / "a.las")
    assert found["positions"][:, 0].tolist() == [0, 2, 3]
    assert found["colors"][:, 0].tolist() == [1, 3, 4]
    texts = [str(warning.message) for warning in warned]
    assert any("2 points are flagged as withheld" in text for text in texts)
    assert any("colours are taken as bytes" in text for text in texts)
    content = bytearray(packed())
    content[179:187] = struct.pack("<d", 1.0)  # the highest x
    (tmp_path / "b.las").write_bytes(content)
    with pytest.warns(UserWarning, match="the bounds in its header are not its points'"):
        assert len(read_points(tmp_path / "b.las")) == 3


def test_without_laspy_the_extra_is_named(tmp_path, without_packages):
    without_packages("laspy")
    (tmp_path / "a.las").write_bytes(packed())
    with pytest.raises(ImportError, match=r"needs laspy: pip install coview\[scans\]"):
        read_recorded(Path(tmp_path / "a.las"))


@pytest.fixture
def packed_scan(tmp_path):
    """Content of a LAZ file that laspy writes, and the byte of its first point."""
    header = laspy.LasHeader(point_format=3, version="1.4")
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = np.random.default_rng(0).uniform(0, 9, (3, 500))
    scan.write(tmp_path / "sound.laz")
    content = (tmp_path / "sound.laz").read_bytes()
    return content, struct.unpack_from("<I", content, 96)[0]


def test_tables_of_chunks_are_checked_before_memory_is_reserved(tmp_path, packed_scan):
    sound, first = packed_scan
    (table,) = struct.unpack_from("<q", sound, first)
    path = tmp_path / "a.laz"
    for content, reason in (
        (with_number(sound, table + 4, "<I", 10**9), "1000000000 chunks are said to be"),
        (with_number(sound, first, "<q", 10**9), "chunks is said to begin at byte 1000000000"),
        (with_number(sound, 235, "<Q", 10**9), ""),  # no record is there
        (with_number(sound, 243, "<I", 10**9), "1000000000 extended records are said to begin"),
        (sound[: first + 4], "cut off|is there"),
        (sound[:-200], "holds no points that can be read"),
    ):
        path.write_bytes(content)
        if not reason:
            assert len(read_recorded(path)["positions"]) == 500
            continue
        with pytest.raises(ValueError, match=reason):
            read_recorded(path)


def test_tables_of_chunks_at_the_end_are_found(tmp_path, packed_scan):
    sound, first = packed_scan
    (table,) = struct.unpack_from("<q", sound, first)
    streamed = with_number(sound, first, "<q", -1) + struct.pack("<q", table)
    (tmp_path / "a.laz").write_bytes(streamed)
    (tmp_path / "b.laz").write_bytes(sound)
    streamed_scan, scan = (read_recorded(tmp_path / name) for name in ("a.laz", "b.laz"))
    np.testing.assert_array_equal(streamed_scan["positions"], scan["positions"])
    (tmp_path / "a.laz").write_bytes(with_number(streamed, len(streamed) - 8, "<q", 10**9))
    with pytest.raises(ValueError, match="chunks is said to begin at byte 1000000000"):
        read_recorded(tmp_path / "a.laz")
