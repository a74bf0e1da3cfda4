"""Collective Perception Messages: captures read by dpkt, messages by asn1tools' decoder.

The modules are a stand-in with the names of the standard's, and the standard's own if COVIEW_ASN1
names their folder. A number n means more than n - 1 and at most n units: readers take the middle."""

import os
import re
import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from toolkit.exchange.collective_perception import BEFORE_2004, OTHER_NUMBERS, TOO_MANY
from toolkit.exchange.cpm_modules import CPM_MODULES
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.geonetworking import PACKET_BYTES
from toolkit.exchange.instant import Instant
from toolkit.exchange.its_clock import count_its_ms
from toolkit.exchange.message_numbers import encode_angles
from toolkit.exchange.object_numbers import NUMBER_COUNT, ObjectNumbers
from toolkit.exchange.perceived_objects import (
    CLIPPED_SCORES,
    COORDINATE_M,
    DIMENSION_M,
    VELOCITY_M_S,
    describe_objects,
)
from toolkit.exchange.pieces import PieceWriter
from toolkit.exchange.standards import open_writer
from toolkit.frame import SensorCloud
from toolkit.objects import LABELS

STAND_IN = Path(__file__).parent / "stand_in"
ORIGIN = GeoOrigin(48.137, -11.575, turn=0.4)
START_S = 1_700_000_000.0
ITS_START_S = 1_072_915_200 - 5  # 2004 and five leap seconds, in seconds since 1970
LABEL_OF_CLASS = {
    ("vehicleSubClass", 5): "vehicle",
    ("vehicleSubClass", 8): "heavy",
    ("vruSubClass", ("pedestrian", 1)): "pedestrian",
    ("vruSubClass", ("bicyclistAndLightVruVehicle", 1)): "cyclist",
}
# a coordinate of ASN.1 in which no place 10 m away fits
SMALL = "SEQUENCE { value INTEGER (-999..999), confidence INTEGER (1..4096) }"
CONTAINERS = {
    2: "OriginatingRsuContainer",
    3: "SensorInformationContainer",
    5: "PerceivedObjectContainer",
}


@pytest.fixture(params=["stand-in", "standard"])
def modules(request):
    """Folder of ASN.1 modules."""
    pytest.importorskip("asn1tools")
    if request.param == "stand-in":
        return STAND_IN
    if "COVIEW_ASN1" not in os.environ:
        pytest.skip("COVIEW_ASN1 names no folder of ETSI's modules")
    return Path(os.environ["COVIEW_ASN1"])


@pytest.fixture
def stand_in(tmp_path):
    """The stand-in's text, and a function that writes it to a folder after a replacement."""
    pytest.importorskip("asn1tools")

    def write_changed(old="", new=""):
        text = (STAND_IN / "collective.asn").read_text()
        assert old in text
        folder = tmp_path / "asn1"
        folder.mkdir()
        (folder / "all.ASN1").write_text(text.replace(old, new))
        return folder

    return write_changed


def make_decoder(folder):
    """Decode a message. asn1tools gets unions as ranges: it has no unions of its own."""
    import asn1tools

    text = "\n".join(path.read_text(errors="replace") for path in sorted(folder.rglob("*.asn")))
    ranges = re.sub(r"\(\s*\w+\s*\|\s*\w+\s*\.\.\s*\w+\s*\|\s*\w+\s*\)", "(0..14)", text)
    assert ranges != text
    specification = asn1tools.compile_string(ranges, "uper")

    def decode(message):
        content = specification.decode(
            "CollectivePerceptionMessage", message, check_constraints=True
        )
        containers = {}
        for container in content["payload"]["cpmContainers"]:
            name = CONTAINERS[container["containerId"]]
            data = container["containerData"]
            containers[name] = specification.decode(name, data, check_constraints=True)
        return content["header"], content["payload"]["managementContainer"], containers

    return decode


def read_capture(path):
    """Time and message of each frame, after checks of all headers."""
    dpkt = pytest.importorskip("dpkt")
    with path.open("rb") as file:
        reader = dpkt.pcap.Reader(file)
        assert reader.datalink() == dpkt.pcap.DLT_EN10MB
        for time_s, content in reader:
            frame = dpkt.ethernet.Ethernet(content)
            assert (frame.dst, frame.type) == (b"\xff" * 6, 0x8947)
            headers, payload = frame.data[:40], frame.data[40:]
            # version 1 and common header, 1 s, one hop; BTP-B, single hop, one hop
            assert headers[:4] == bytes([0x11, 0, 5, 1])
            assert headers[4:8] == bytes([0x20, 0x50, 2, 0])
            assert headers[8:12] == struct.pack(">HBB", len(payload), 1, 0)
            address, mac, stamp, latitude, longitude = struct.unpack(">H6sIii", headers[12:32])
            assert (address >> 10, mac) == (15, frame.src)
            assert (latitude, longitude) == (481_370_000, -115_750_000)
            assert headers[32:] == bytes(8)
            assert payload[:4] == struct.pack(">HH", 2009, 0)
            assert len(payload) <= PACKET_BYTES == 1398
            yield float(time_s), stamp, payload[4:]


def read_objects(objects):
    """Boxes in the world frame, velocities (NaN if unknown) and labels by id."""
    rows = {}
    for found in objects:
        assert found["measurementDeltaTime"] == 0
        east, north, up = (
            (found["position"][f"{k}Coordinate"]["value"] - 0.5) / 100 for k in "xyz"
        )
        sizes = [(found[f"objectDimension{axis}"]["value"] - 0.5) / 10 for axis in "XYZ"]
        tenths = found["angles"]["zAngle"]["value"]
        assert 0 <= tenths < 3600
        velocity = [np.nan, np.nan]
        if "velocity" in found:
            kind, components = found["velocity"]
            assert kind == "cartesianVelocity"
            velocity = [(components[f"{k}Velocity"]["value"] - 0.5) / 100 for k in "xy"]
        x, y = turned(east, north)
        yaw = np.deg2rad((tenths - 0.5) / 10) - ORIGIN.turn
        (described,) = found["classification"]
        assert found["objectId"] not in rows
        label = LABEL_OF_CLASS[described["objectClass"]]
        rows[found["objectId"]] = [x, y, up, *sizes, yaw], turned(*velocity), label, found
    return rows


def turned(east, north):
    cosine, sine = np.cos(ORIGIN.turn), np.sin(ORIGIN.turn)
    return cosine * east + sine * north, cosine * north - sine * east


def street(seed, count, time_s=START_S, **changes):
    """Road users at random, with all that a track knows."""
    rng = np.random.default_rng(seed)
    low, high = [-500, -500, -3, 0.3, 0.3, 0.3, -9], [500, 500, 9, 25, 4, 5, 9]
    fields = {
        "boxes": rng.uniform(low, high, (count, 7)),
        "labels": rng.integers(0, 4, count),
        "scores": rng.uniform(0, 1, count),
        "ids": rng.permutation(NUMBER_COUNT)[:count],
        "velocities": rng.normal(0, 15, (count, 3)),
        "ages": rng.uniform(0, 3, count),
    }
    return Instant(time_s, **fields | changes)


def write(path, modules, instants, origin=ORIGIN):
    """Write a capture; return what was clipped."""
    with open_writer("cpm", path, origin=origin, asn1=modules) as writer:
        for instant in instants:
            writer.write(instant)
        return dict(writer.problems)


def test_boxes_ids_and_times_come_back(tmp_path, modules):
    instants = [street(k, 12, START_S + 0.1 * k) for k in range(10)]
    instants[3].velocities[5] = np.nan
    assert write(tmp_path / "a.pcap", modules, instants) == {}
    decode = make_decoder(modules)
    frames = list(read_capture(tmp_path / "a.pcap"))
    assert len(frames) == 10
    for (time_s, stamp, message), instant in zip(frames, instants, strict=True):
        header, management, containers = decode(message)
        assert header == {"protocolVersion": 2, "messageId": 14, "stationId": 1}
        assert time_s == pytest.approx(instant.time_s, abs=1e-6)
        assert management["referenceTime"] / 1000 + ITS_START_S == pytest.approx(time_s, abs=5e-4)
        assert stamp == management["referenceTime"] % 2**32
        assert management["referencePosition"]["latitude"] == 481_370_000
        assert "segmentationInfo" not in management
        assert containers["OriginatingRsuContainer"] == {}
        assert "SensorInformationContainer" not in containers
        assert containers["PerceivedObjectContainer"]["numberOfPerceivedObjects"] == 12
        rows = read_objects(containers["PerceivedObjectContainer"]["perceivedObjects"])
        assert list(rows) == instant.ids.tolist()
        for k, (box, velocity, label, found) in enumerate(rows.values()):
            east_north = np.array(turned_back(*(box - instant.boxes[k])[:2]))
            assert np.abs(east_north).max() < 0.005 + 1e-6
            assert abs(box[2] - instant.boxes[k, 2]) < 0.005 + 1e-6
            assert np.abs(box[3:6] - instant.boxes[k, 3:6]).max() < 0.05 + 1e-6
            turn_deg = np.rad2deg(box[6] - instant.boxes[k, 6])
            assert abs((turn_deg + 180) % 360 - 180) < 0.05 + 1e-6
            assert label == LABELS[instant.labels[k]]
            assert found["objectPerceptionQuality"] == np.ceil(15 * instant.scores[k])
            assert found["classification"][0]["confidence"] == np.ceil(100 * instant.scores[k])
            assert found["objectAge"] == min(np.ceil(1000 * instant.ages[k]), 1500)
            assert np.isnan(velocity).all() == np.isnan(instant.velocities[k]).any()
            if not np.isnan(velocity).any():
                differences = turned_back(*np.subtract(velocity, instant.velocities[k, :2]))
                assert np.abs(differences).max() < 0.005 + 1e-6


def turned_back(x, y):
    cosine, sine = np.cos(ORIGIN.turn), np.sin(ORIGIN.turn)
    return cosine * x - sine * y, sine * x + cosine * y


def test_every_message_fits_a_packet_and_segments_make_a_whole(tmp_path, modules):
    decode = make_decoder(modules)
    counts = [0, 1, 38, 39, 40, 41, 60, 100, 200, 255, 500]
    bare = {"velocities": None, "ages": None}
    instants = [street(k, count, START_S + k) for k, count in enumerate(counts)]
    instants += [street(k, count, START_S + 20 + k, **bare) for k, count in enumerate(counts)]
    problems = write(tmp_path / "a.pcap", modules, instants)
    assert problems == {TOO_MANY: 2 * (500 - 255)}
    by_time = {}
    for time_s, _, message in read_capture(tmp_path / "a.pcap"):
        by_time.setdefault(time_s, []).append(decode(message))
    assert list(by_time) == [instant.time_s for instant in instants]
    for instant, messages in zip(instants, by_time.values(), strict=True):
        sent = min(len(instant), 255)
        assert len({management["referenceTime"] for _, management, _ in messages}) == 1
        infos = [management.get("segmentationInfo") for _, management, _ in messages]
        total = len(messages)
        if total == 1:
            assert infos == [None]
        else:
            assert infos == [{"totalMsgNo": total, "thisMsgNo": k + 1} for k in range(total)]
        containers = [found["PerceivedObjectContainer"] for *_, found in messages]
        assert {row["numberOfPerceivedObjects"] for row in containers} == {sent}
        sizes = [len(row["perceivedObjects"]) for row in containers]
        assert sum(sizes) == sent
        assert max(sizes) - min(sizes) <= 1
        ids = [found["objectId"] for row in containers for found in row["perceivedObjects"]]
        surest = np.sort(np.argsort(-instant.scores, kind="stable")[:255])
        assert ids == instant.ids[surest].tolist()


def test_what_is_out_of_range_has_the_standards_codes():
    instant = street(0, 4, labels=np.arange(4))
    instant.boxes[:] = [[1310.695, -1310.715, 0, 25.4, 25.41, 400, 0]] + [[0, 0, 0, 1, 1, 1, 0]] * 3
    instant.boxes[1, :3] = [1310.705, -1310.725, 1e5]
    instant.velocities[:2] = [[163.805, -163.825, 0], [163.82, -163.84, 0]]
    instant.velocities[2:] = 0.0
    instant.scores[:] = [0.0, -5.0, 1.0, 7.0]
    instant.ages[:] = [0.0, 1.5, 1.5001, 100]
    problems = {}
    rows = describe_objects(instant, [0, 1, 2, 3], 0.0, problems)
    coordinates = [[row["position"][f"{k}Coordinate"]["value"] for k in "xyz"] for row in rows]
    assert coordinates == [[131_070, -131_071, 0], [131_071, -131_072, 131_071], [0] * 3, [0] * 3]
    assert [rows[0][f"objectDimension{axis}"]["value"] for axis in "XYZ"] == [254, 255, 255]
    speeds = [[row["velocity"][1][f"{k}Velocity"]["value"] for k in "xy"] for row in rows]
    assert speeds == [[16_381, -16_382], [16_382, -16_383], [0, 0], [0, 0]]
    assert [row["objectPerceptionQuality"] for row in rows] == [0, 0, 15, 15]
    assert [row["classification"][0]["confidence"] for row in rows] == [1, 1, 100, 100]
    assert [row["objectAge"] for row in rows] == [0, 1500, 1500, 1500]
    assert problems == {
        COORDINATE_M.problem: 3,
        DIMENSION_M.problem: 2,
        VELOCITY_M_S.problem: 2,
        CLIPPED_SCORES: 2,
    }


def test_numbers_are_rounded_up():
    """The examples of the standard's descriptions: a car of 4.52 by 1.83 m at 13.901 m/s."""
    problems = {}
    assert DIMENSION_M.encode(np.array([4.52, 1.83, 4.6, 1.1]), problems).tolist() == [
        46,
        19,
        46,
        11,
    ]
    assert VELOCITY_M_S.encode(np.array([13.901, 0.29, -0.291]), problems).tolist() == [
        1391,
        29,
        -29,
    ]
    hundredths = np.arange(-13_000, 13_001)
    assert COORDINATE_M.encode(hundredths / 100, problems).tolist() == hundredths.tolist()
    assert problems == {}


def test_angles_are_never_a_full_turn():
    angles = np.deg2rad(np.linspace(-1000, 1000, 400_001))
    tenths = encode_angles(angles)
    assert (tenths.min(), tenths.max()) == (0, 3599)
    behind = (tenths - 10 * np.rad2deg(angles)) % 3600
    assert ((behind < 1.001) | (behind > 3599.999)).all()


@pytest.mark.parametrize(
    ("moment", "its_ms"),
    [
        ("2004-01-01T00:00:00+00:00", 0),
        ("2007-01-01T00:00:00+00:00", 94_694_401_000),
        ("2016-12-31T23:59:59.999+00:00", 410_313_603_999),
        ("2017-01-01T00:00:00+00:00", 410_313_605_000),
    ],
)
def test_the_clock_counts_leap_seconds(moment, its_ms):
    assert count_its_ms(datetime.fromisoformat(moment).timestamp()) == its_ms


def test_the_clock_agrees_with_generation_times_of_others():
    moment = datetime(2026, 5, 4, 10, 0, 0, 250_000, tzinfo=UTC)
    assert count_its_ms(moment.timestamp()) % 65_536 == 35_202


def test_a_clock_that_begins_with_the_recording(tmp_path, modules):
    instants = [street(k, 1, 0.1 * k) for k in range(3)]
    assert write(tmp_path / "a.pcap", modules, instants) == {BEFORE_2004: 3}
    decode = make_decoder(modules)
    frames = list(read_capture(tmp_path / "a.pcap"))
    assert [time_s for time_s, *_ in frames] == [0.0, 0.1, 0.2]
    times_ms = [decode(message)[1]["referenceTime"] for *_, message in frames]
    assert times_ms == [0, 100, 200]


def test_sensors_are_sent_once_in_a_second(tmp_path, modules):
    points = np.zeros((1, 3), np.float32)
    north, south = (SensorCloud(name, points, np.eye(4)) for name in ("north", "south"))
    seen = {0: (north,), 4: (north, south), 12: (south,)}
    instants = [street(k, 1, START_S + 0.1 * k, clouds=seen.get(k, ())) for k in range(22)]
    write(tmp_path / "a.pcap", modules, instants)
    decode = make_decoder(modules)
    listed = {}
    for k, (*_, message) in enumerate(read_capture(tmp_path / "a.pcap")):
        sensors = decode(message)[2].get("SensorInformationContainer")
        if sensors:
            listed[k] = [(row["sensorId"], row["shadowingApplies"]) for row in sensors]
    assert listed == {0: [(0, True)], 10: [(0, True), (1, True)], 20: [(0, True), (1, True)]}


def test_large_ids_get_numbers_that_stay(tmp_path, modules):
    ids = [7, 65_543, 10**9, 65_535]
    instants = [street(k, 4, START_S + k, ids=np.array(ids)) for k in range(3)]
    assert write(tmp_path / "a.pcap", modules, instants) == {OTHER_NUMBERS: 6}
    decode = make_decoder(modules)
    for *_, message in read_capture(tmp_path / "a.pcap"):
        objects = decode(message)[2]["PerceivedObjectContainer"]["perceivedObjects"]
        assert [found["objectId"] for found in objects] == [7, 8, 10**9 % 65_536, 65_535]


def test_the_number_of_the_one_that_is_gone_longest_is_given_again():
    numbers = ObjectNumbers()
    assert numbers.assign(range(NUMBER_COUNT)) == list(range(NUMBER_COUNT))
    assert numbers.assign([0, 1]) == [0, 1]
    assert numbers.assign([70_000, 0, 70_001]) == [2, 0, 3]
    assert numbers.assign([2, 70_000]) == [4, 2]  # its number was given away
    for k in range(5):  # new ones, as of detections that nobody tracks
        fresh = numbers.assign(range(10**6 + 300 * k, 10**6 + 300 * (k + 1)))
        assert len(set(fresh)) == 300


def test_a_place_at_the_date_line(tmp_path, modules):
    write(tmp_path / "a.pcap", modules, [street(0, 1)], origin=GeoOrigin(-17.0, -180.0))
    dpkt = pytest.importorskip("dpkt")
    with (tmp_path / "a.pcap").open("rb") as file:
        ((_, content),) = dpkt.pcap.Reader(file)
    _, position, _ = make_decoder(modules)(content[58:])
    assert position["referencePosition"]["longitude"] == 1_800_000_000


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("CPM-PerceptionRegionContainer DEFINITIONS", "Another DEFINITIONS", "lacks the ASN.1 module CPM-P"),
        ("ETSI-ITS-CDD DEFINITIONS", "CPM-PDU-Descriptions DEFINITIONS", "CPM-PDU-Descriptions in all"),
        ("header ItsPduHeader,", "header ItsPduHeader", "is no folder of ASN.1 modules that can be"),
        ("Speed ::=", "Velocity ::=", "is no folder of ASN.1 modules that can be read"),
        ("objectId INTEGER (0..65535)", "objectId INTEGER (0..255)", "do not fit TS 103 324 V2.1.1"),
        ("INTEGER (-131072..131071)", "INTEGER (0..131071)", "do not fit TS 103 324 V2.1.1"),
        ("INTEGER (-131072..131071)", "INTEGER (-131072..0)", "do not fit TS 103 324 V2.1.1"),
        *(
            (f"{axis}Coordinate Coordinate", f"{axis}Coordinate {SMALL}", "do not fit TS 103 324 V2.1.1")
            for axis in "xyz"
        ),
        ("vruSubClass CHOICE", "walking CHOICE", "do not fit TS 103 324 V2.1.1"),
        ("xCoordinate Coordinate", "x Coordinate", "do not fit TS 103 324 V2.1.1"),
        ("OriginatingRsuContainer ::=", "Rsu ::=", "OriginatingRsuContainer"),
    ],
)  # fmt: skip
def test_modules_that_are_wrong_are_refused(tmp_path, stand_in, old, new, reason):
    folder = stand_in(old, new)
    with pytest.raises(ValueError, match=reason) as raised:
        write(tmp_path / "a.pcap", folder, [])
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == [folder]


def test_modules_that_are_missing_are_named(tmp_path):
    pytest.importorskip("asn1tools")
    with pytest.raises(ValueError, match="cpm needs ETSI's ASN\\.1 modules"):
        write(tmp_path / "a.pcap", None, [])
    with pytest.raises(ValueError, match="cpm needs ETSI's ASN\\.1 modules"):
        PieceWriter({"cpm": tmp_path}, piece_s=1.0, origin=ORIGIN)
    with pytest.raises(NotADirectoryError, match="missing is no folder"):
        write(tmp_path / "a.pcap", tmp_path / "missing", [])
    with pytest.raises(ValueError, match="lacks the ASN\\.1 module CPM-PDU-Descriptions"):
        write(tmp_path / "a.pcap", tmp_path, [])
    assert list(tmp_path.iterdir()) == []


def test_a_file_for_each_module_and_others_among_them(tmp_path, stand_in):
    folder = stand_in()
    text = (folder / "all.ASN1").read_text()
    (folder / "all.ASN1").unlink()
    (folder / "cdd").mkdir()
    parts = re.findall(r"^([\w-]+) DEFINITIONS.*?^END$", text, re.MULTILINE | re.DOTALL)
    assert set(parts) == set(CPM_MODULES)
    for part in re.finditer(r"^([\w-]+) DEFINITIONS.*?^END$", text, re.MULTILINE | re.DOTALL):
        inside = folder / "cdd" if part[1] == "ETSI-ITS-CDD" else folder
        (inside / f"{part[1]}.asn").write_text(f"-- DEFINITIONS of {part[1]}\n{part[0]}\n")
    (folder / "CAM.asn").write_text("CAM-PDU { itu-t (0) } DEFINITIONS ::= BEGIN broken")
    write(tmp_path / "a.pcap", folder, [street(0, 3)])
    (frame,) = read_capture(tmp_path / "a.pcap")
    assert (
        len(make_decoder(STAND_IN)(frame[2])[2]["PerceivedObjectContainer"]["perceivedObjects"])
        == 3
    )


def test_pieces_of_a_running_centre(tmp_path, modules):
    writer = PieceWriter({"cpm": tmp_path / "out"}, piece_s=1.0, origin=ORIGIN, asn1=modules)
    for k in range(15):
        writer.write(street(k, 2, START_S + 0.1 * k))
    writer.close()
    files = sorted((tmp_path / "out").iterdir())
    assert [len(list(read_capture(path))) for path in files] == [10, 5]


def extreme(seed):
    """Fields of instants with something wrong or rare in them."""
    rng = np.random.default_rng(seed)
    time_s = rng.choice([0.0, START_S, 4.2e9])
    for k in range(3):
        count = int(rng.choice([0, 1, 3, 45, 500]))
        scale = rng.choice([1.0, 30.0])
        low, high = [-900, -900, -3, 1e-9, 1e-9, 1e-9, -9], [900, 900, 9, 20, 20, 20, 9]
        fields = {
            "time_s": time_s + 0.1 * k,
            "boxes": scale * rng.uniform(low, high, (count, 7)),
            "labels": rng.integers(0, 4, count),
            "scores": rng.uniform(-2, 3, count),
            "ids": rng.permutation(10**6)[:count] if rng.random() < 0.8 else None,
            "velocities": scale * rng.normal(0, 40, (count, 3)),
            "ages": rng.uniform(0, 1e4, count) if rng.random() < 0.8 else None,
        }
        change = rng.integers(0, 9) if k == 1 else 99
        wrong = rng.choice([np.nan, np.inf, -np.inf, 1e300, 0.0, -1.0])
        if count and change == 0:
            fields["boxes"][rng.integers(count), rng.integers(7)] = wrong
        elif count and change == 1:
            fields["velocities"][rng.integers(count)] = wrong
        elif count and change == 2:
            fields["scores"][rng.integers(count)] = wrong
        elif change == 3:
            fields["time_s"] -= rng.choice([0.1, 1e6])
        elif change == 4:
            fields["time_s"] = rng.choice([np.nan, np.inf, -1.0, 1e12, 4.3e9])
        elif count and change == 5 and fields["ages"] is not None:
            fields["ages"][0] = wrong
        elif change == 6:
            fields["velocities"][:] = np.nan
        yield fields


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(10, 200), marks=pytest.mark.slow)])
def test_extreme_inputs_give_one_line_or_a_sound_capture(tmp_path, modules, seeds):
    decode = make_decoder(modules)
    refused = []
    for seed in seeds:
        path = tmp_path / f"{seed}.pcap"
        try:
            instants = [Instant(**fields) for fields in extreme(seed)]
            write(path, modules, instants)
        except ValueError as error:
            refused.append(str(error))
            assert not path.exists()
            continue
        counts = {}
        for time_s, _, message in read_capture(path):
            _, _, containers = decode(message)
            objects = containers["PerceivedObjectContainer"]["perceivedObjects"]
            rows = read_objects(objects)
            assert len(rows) == len(objects)
            counts[time_s] = counts.get(time_s, 0) + len(rows)
        assert list(counts.values()) == [min(len(instant), 255) for instant in instants]
    assert len(seeds) / 20 < len(refused) < len(seeds) * 3 / 4
    assert all("\n" not in text for text in refused)


@pytest.mark.parametrize("ages", [[-1.0], [np.nan], [1.0, 2.0]])
def test_ages_that_are_none_are_refused(ages):
    with pytest.raises((ValueError, TypeError), match=r"ages must be|parameter 'ages'"):
        street(0, 1, ages=np.array(ages))
