"""Writers of detections and tracks, each read back by a package of somebody else.

Boxes agree within 1 mm and 0.1 degrees, ids exactly, times within a microsecond, velocities and
scores within what the format's digits hold."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import STANDARDS, find_standard, open_writer
from toolkit.exchange.writer import nanoseconds
from toolkit.frame import SensorCloud
from toolkit.geometry import MAX_COORDINATE_M, pose
from toolkit.objects import LABELS, Detections

ORIGIN = GeoOrigin(48.137, 11.575, turn=0.4)
START_S = 1_700_000_000.0
MAX_APART_M = 1e-3
MAX_TURN_APART_RAD = np.deg2rad(0.1)
OTHER_NAMES = {
    "car": "vehicle",
    "bicycle": "cyclist",
    "cyclist": "cyclist",
    "pedestrian": "pedestrian",
    "truck": "heavy",
    "heavy_truck": "heavy",
}


def boxes_at(k: int, rows: np.ndarray) -> np.ndarray:
    """Boxes of some road users in instant k: they drive on, and turn through half turns."""
    rng = np.random.default_rng(5)
    first = rng.uniform([-90, -90, 0.5, 3, 1.5, 1.2, -4], [90, 90, 2, 12, 2.5, 3.5, 4], (8, 7))
    moved = first.copy()
    moved[:, :2] += 0.9 * k * np.stack([np.cos(first[:, 6]), np.sin(first[:, 6])], axis=1)
    moved[:, 6] += 0.35 * k
    return moved[rows]


def traffic(count: int = 9) -> Iterator[Instant]:
    """Tracks that begin, end, return after a gap and lack a velocity, and an instant of none."""
    for k in range(count):
        rows = np.array([n for n in range(8) if k != 4 and (n + k) % 5 and not (n == 2 and k < 3)])
        rows = rows.astype(int)
        boxes = boxes_at(k, rows)
        speeds = np.column_stack([3.0 + rows, -2.0 + 0.25 * k + 0 * rows, 0 * rows])
        speeds[rows == 5] = np.nan
        cloud = SensorCloud(
            "north",
            np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, k]], np.float32),
            pose(10.0, -3.0, 6.0, yaw=0.7, pitch=0.3),
            intensity=np.array([0.25, 1.0], np.float32),
            stamp_s=START_S + 0.1 * k + 0.003,
        )
        scores = 0.1 + 0.01 * rows + 0.05 * k
        yield Instant(START_S + 0.1 * k, boxes, rows % 4, scores, 10 * rows + 3, speeds, (cloud,))


def make(time_s, boxes, labels, scores, ids=None, velocities=None):
    """An instant of lists."""
    return Instant(
        time_s,
        np.asarray(boxes, float),
        np.asarray(labels, int),
        np.asarray(scores, float),
        None if ids is None else np.asarray(ids),
        None if velocities is None else np.asarray(velocities, float),
    )


class Row:
    """What a foreign package read of one object; None for what the format lacks."""

    def __init__(self, label, box, score=None, velocity=None, speed=None):
        self.label, self.box, self.score = label, np.asarray(box, float), score
        self.velocity, self.speed = velocity, speed


def read_kitti(path):
    motrics = pytest.importorskip("motrics")
    frames = motrics.load_kitti_3d(path)
    kinds = {1: "car", 3: "truck", 4: "pedestrian", 6: "cyclist"}
    for frame, (ids, boxes, _, classes) in frames.items():
        rows = {}
        for number, (x, y, z, length, width, height, turn), kind in zip(
            ids, boxes, classes, strict=True
        ):
            box = [z, -x, -y, length, width, height, -turn - np.pi / 2]
            rows[number] = Row(kinds[kind], box)
        yield frame, None, rows


def read_openlabel(path):
    models = pytest.importorskip("kognic.openlabel.models")
    content = models.OpenLabelAnnotation.model_validate(json.loads(path.read_text())).openlabel
    for key, frame in content.frames.items():
        rows = {}
        for number, entry in (frame.objects or {}).items():
            data = entry.object_data
            x, y, z, *turn, length, width, height = data.cuboid[0].val
            yaw = 2 * np.arctan2(turn[2], turn[3])
            velocity = data.vec[0].val if data.vec else None
            box = [x, y, z, length, width, height, yaw]
            kind = content.objects[number].type.lower()
            rows[int(number)] = Row(kind, box, data.num[0].val, velocity)
        stamp = frame.frame_properties.timestamp
        yield int(key), None if stamp is None else float(stamp), rows


def read_foxglove(path):
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_protobuf.decoder")
    with path.open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for frame, (_, _, message, scene) in enumerate(
            messages.iter_decoded_messages(topics=["/objects"])
        ):
            rows = {}
            for entity in scene.entities:
                facts = {pair.key: pair.value for pair in entity.metadata}
                (cube,) = entity.cubes
                turn = cube.pose.orientation
                place, size = cube.pose.position, cube.size
                yaw = 2 * np.arctan2(turn.z, turn.w)
                box = [place.x, place.y, place.z, size.x, size.y, size.z, yaw]
                velocity = facts.get("velocity")
                assert entity.frame_id == "world"
                rows[int(entity.id)] = Row(
                    facts["label"],
                    box,
                    float(facts["score"]),
                    velocity and [float(word) for word in velocity.split()],
                )
            assert message.log_time == message.publish_time
            yield frame, message.log_time / 1e9, rows


def read_bag(path):
    """By mcap-ros2-support: a parser of ROS messages that shares nothing with rosbags."""
    reader = pytest.importorskip("mcap_ros2.reader")
    (bag,) = path.rglob("*.mcap")
    for frame, found in enumerate(reader.read_ros2_messages(str(bag), topics=["/detections"])):
        message = found.ros_msg
        rows = {}
        for detection in message.detections:
            centre, size = detection.bbox.center, detection.bbox.size
            yaw = 2 * np.arctan2(centre.orientation.z, centre.orientation.w)
            place = centre.position
            box = [place.x, place.y, place.z, size.x, size.y, size.z, yaw]
            (result,) = detection.results
            hypothesis = result.hypothesis
            rows[int(detection.id)] = Row(hypothesis.class_id, box, hypothesis.score)
        assert message.header.frame_id == "world"
        yield frame, message.header.stamp.sec + message.header.stamp.nanosec / 1e9, rows


def read_osi(path):
    """By the schema in the file and Google's protobuf, which betterosi does not use."""
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_protobuf.decoder")
    with path.open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for frame, (_, _, _, truth) in enumerate(messages.iter_decoded_messages()):
            check_osi_rules(truth)
            rows = {}
            for moving in truth.moving_object:
                base = moving.base
                place, size = base.position, base.dimension
                lengths = [size.length, size.width, size.height]
                box = [place.x, place.y, place.z, *lengths, base.orientation.yaw]
                kind = "pedestrian"
                if moving.HasField("vehicle_classification"):
                    classes = moving.vehicle_classification
                    kind = classes.Type.Name(classes.type).removeprefix("TYPE_").lower()
                velocity = None
                if base.HasField("velocity"):
                    velocity = [base.velocity.x, base.velocity.y, base.velocity.z]
                score = float(moving.source_reference[0].identifier[0].partition("=")[2])
                rows[moving.id.value] = Row(kind, box, score, velocity)
            yield frame, truth.timestamp.seconds + truth.timestamp.nanos / 1e9, rows


def check_osi_rules(truth):
    """Rules of osi_version, osi_common and osi_object.proto for the fields that are written."""
    assert (truth.version.version_major, truth.version.version_minor) == (3, 8)
    assert truth.HasField("timestamp")
    assert 0 <= truth.timestamp.nanos < 10**9
    ids = [moving.id.value for moving in truth.moving_object]
    assert len(set(ids)) == len(ids)
    for moving in truth.moving_object:
        size, turn = moving.base.dimension, moving.base.orientation
        assert min(size.length, size.width, size.height) > 0
        assert -np.pi <= turn.yaw <= np.pi
        is_vehicle = moving.Type.Name(moving.type) == "TYPE_VEHICLE"
        assert moving.HasField("vehicle_classification") == is_vehicle


def read_moving_features(path):
    """By movingpandas, with pyproj for metres: tracks of one instant are none to movingpandas."""
    movingpandas = pytest.importorskip("movingpandas")
    pyproj = pytest.importorskip("pyproj")
    place = f"+proj=topocentric +lat_0={ORIGIN.latitude_deg} +lon_0={ORIGIN.longitude_deg} +h_0=0"
    metres = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+ellps=WGS84 +step {place} +ellps=WGS84"
    )
    frames = {}
    cosine, sine = np.cos(ORIGIN.turn), np.sin(ORIGIN.turn)
    for track in movingpandas.read_mf_json(path, "id").trajectories:
        for moment, row in track.df.iterrows():
            east, north, _ = metres.transform(row.geometry.x, row.geometry.y, 0.0)
            x, y = cosine * east + sine * north, cosine * north - sine * east
            yaw = np.deg2rad(90 - row.bearing) - ORIGIN.turn
            box = [x, y, row.z, row.length, row.width, row.height, yaw]
            known = "speed" in track.df and np.isfinite(row.speed)
            found = Row(None, box, row.score, speed=row.speed if known else None)
            frames.setdefault(moment.timestamp(), {})[track.id] = found
    yield from ((None, seconds, rows) for seconds, rows in sorted(frames.items()))


READERS = {
    "kitti-tracking": read_kitti,
    "openlabel": read_openlabel,
    "mf-json": read_moving_features,
    "mcap": read_foxglove,
    "detection3d": read_bag,
    "osi": read_osi,
}
VELOCITIES = {"openlabel", "mcap", "osi"}


def write(name: str, folder: Path, instants) -> Path:
    """The file of some instants; skip without the packages that the writer needs."""
    for module, _ in find_standard(name).packages:
        pytest.importorskip(module)
    path = folder / f"out{find_standard(name).ending}"
    with open_writer(name, path, origin=ORIGIN) as writer:
        for instant in instants:
            writer.write(instant)
    return path


@pytest.mark.parametrize("name", READERS)
def test_a_foreign_package_reads_what_was_written(name, tmp_path):
    instants = list(traffic())
    frames = list(READERS[name](write(name, tmp_path, instants)))
    if name in ("kitti-tracking", "mf-json"):  # no mark of an instant of none
        instants = [instant for instant in instants if len(instant)]
    assert len(frames) == len(instants)
    for (_, seconds, rows), instant in zip(frames, instants, strict=True):
        if seconds is not None:
            assert seconds == pytest.approx(instant.time_s, abs=1e-6)
        assert set(rows) == set(instant.list_ids())
        velocities = instant.known_velocities()
        for k, number in enumerate(instant.list_ids()):
            row = rows[number]
            assert np.abs(row.box[:6] - instant.boxes[k, :6]).max() < MAX_APART_M
            turn = row.box[6] - instant.boxes[k, 6]
            assert abs(np.arctan2(np.sin(turn), np.cos(turn))) < MAX_TURN_APART_RAD
            if row.label is not None:
                assert OTHER_NAMES.get(row.label, row.label) == LABELS[instant.labels[k]]
            if row.score is not None:
                assert row.score == pytest.approx(instant.scores[k], abs=1e-4)
            if name in VELOCITIES:
                assert (row.velocity is None) == (velocities[k] is None)
                assert row.velocity is None or row.velocity == pytest.approx(
                    velocities[k], abs=1e-4
                )
            if name == "mf-json":
                velocity = velocities[k]
                speed = None if velocity is None else np.hypot(velocity[0], velocity[1])
                assert row.speed == (None if speed is None else pytest.approx(speed, abs=1e-3))


def test_kitti_rows_score_as_themselves_and_false_ones_count(tmp_path):
    motrics = pytest.importorskip("motrics")
    path = write("kitti-tracking", tmp_path, traffic())
    truth, ignored = motrics.load_kitti_3d_gt(path)
    for wrong in (0, 1):
        found = motrics.load_kitti_3d(path)
        for ids, *columns in found.values():
            if wrong:  # as many boxes a kilometre off, which are false alarms
                ids += [1000 + number for number in ids]
                columns[0] += [(x + 1000, *rest) for x, *rest in columns[0]]
                columns[1] += columns[1]
                columns[2] += columns[2]
        matched = motrics.preprocess_kitti_3d(truth, found, "car", ignore_regions=ignored)
        figures = motrics.compute_clear_from_similarity(*matched)
        assert figures.mota == pytest.approx(1.0 if not wrong else 0.0)


def test_openlabel_follows_the_schema(tmp_path):
    checker = pytest.importorskip("openlabel_checker")
    for count in (0, 9):
        report = checker.check_file(str(write("openlabel", tmp_path, traffic(count))))
        wrong = [issue.message for issue in report.issues if issue.severity.value == "error"]
        assert wrong == []


def test_openlabel_intervals_are_the_frames_of_each_id(tmp_path):
    path = write("openlabel", tmp_path, traffic())
    content = json.loads(path.read_text())["openlabel"]
    for number, described in content["objects"].items():
        listed = set()
        for interval in described["frame_intervals"]:
            listed |= set(range(interval["frame_start"], interval["frame_end"] + 1))
        shown = {int(key) for key, frame in content["frames"].items() if number in frame["objects"]}
        assert listed == shown
    assert content["frame_intervals"] == [{"frame_start": 0, "frame_end": 8}]


def test_clouds_in_mcap_are_foxgloves(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_protobuf.decoder")
    instants = list(traffic(3))
    path = write("mcap", tmp_path, instants)
    with path.open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        clouds = list(messages.iter_decoded_messages(topics=["/points/north"]))
    assert len(clouds) == 3
    for (schema, _, message, cloud), instant in zip(clouds, instants, strict=True):
        assert schema.name == "foxglove.PointCloud"
        assert {field.name: field.type for field in cloud.fields} == dict.fromkeys(
            ("x", "y", "z", "intensity"), 7
        )  # FLOAT32; 7 is ROS's too, where 8 is FLOAT64 in both
        (sensor,) = instant.clouds
        table = np.frombuffer(cloud.data, "<f4").reshape(-1, cloud.point_stride // 4)
        np.testing.assert_array_equal(table[:, :3], sensor.points)
        np.testing.assert_array_equal(table[:, 3], sensor.intensity)
        turn, place = cloud.pose.orientation, cloud.pose.position
        rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        np.testing.assert_allclose(rotation, sensor.world_SE3_sensor[:3, :3], atol=1e-12)
        assert [place.x, place.y, place.z] == sensor.world_SE3_sensor[:3, 3].tolist()
        assert cloud.timestamp.ToNanoseconds() == nanoseconds(sensor.stamp_s)
        assert message.log_time == nanoseconds(instant.time_s)


def test_an_entity_that_is_gone_is_deleted_by_its_id(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_protobuf.decoder")
    path = write("mcap", tmp_path, traffic())
    shown = set()
    with path.open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for _, _, _, scene in messages.iter_decoded_messages(topics=["/objects"]):
            shown -= {deletion.id for deletion in scene.deletions}
            shown |= {entity.id for entity in scene.entities}
            assert shown == {entity.id for entity in scene.entities}


def test_the_bag_counts_the_velocities_it_leaves_out(tmp_path):
    pytest.importorskip("rosbags")
    with open_writer("detection3d", tmp_path / "bag") as writer:
        for instant in traffic(2):
            writer.write(instant)
        (count,) = writer.problems.values()
    known = [v for instant in traffic(2) for v in instant.known_velocities() if v is not None]
    assert count == len(known) > 0


@pytest.mark.parametrize("name", READERS)
def test_extremes_give_a_sound_file(name, tmp_path):
    """None at all, 500 objects at once, speeds that nobody knows, one object very far away."""
    rng = np.random.default_rng(1)
    many = rng.uniform([-200, -200, 0, 0.3, 0.3, 0.3, -9], [200, 200, 2, 25, 3, 4, 9], (500, 7))
    crowd = Instant(
        START_S,
        many,
        np.arange(500) % 4,
        np.linspace(0, 1, 500),
        velocities=np.full((500, 3), np.nan),
    )
    nobody = make(START_S + 1, np.zeros((0, 7)), [], [], [], np.zeros((0, 3)))
    far = make(START_S + 2, [[9e4, -9e4, 0, 1e-3, 400, 1, 1e5]], [0], [-3.0], [2**31])
    for number, instants in enumerate(([], [nobody], [crowd, nobody, crowd_after(crowd)], [far])):
        folder = tmp_path / str(number)
        path = write(name, folder, instants)
        if name == "mf-json":  # movingpandas takes no track of one instant
            features = json.loads(path.read_text())["features"]
            assert len(features) == sum(map(len, instants))
            continue
        found = list(READERS[name](path))
        assert sum(len(rows) for _, _, rows in found) == sum(map(len, instants))
        assert all(row.velocity is None for _, _, rows in found for row in rows.values())


def crowd_after(crowd: Instant) -> Instant:
    """The same crowd two seconds later."""
    return Instant(crowd.time_s + 2, crowd.boxes, crowd.labels, crowd.scores)


@pytest.mark.parametrize("name", READERS)
def test_times_that_do_not_rise_are_refused_and_nothing_is_left(name, tmp_path):
    first, second, *_ = traffic(2)
    for later in (first, second):
        with pytest.raises(ValueError, match="times must rise, but 1700000000"):
            write(name, tmp_path, [second, later])
        assert list(tmp_path.iterdir()) == []
    nameless = Instant(float("nan"), first.boxes, first.labels, first.scores)
    if find_standard(name).needs_time:
        with pytest.raises(ValueError, match="needs the time of every frame, got nan"):
            write(name, tmp_path, [nameless])
        assert list(tmp_path.iterdir()) == []
    else:
        write(name, tmp_path, [nameless, nameless])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"boxes": [[0, 0, np.nan, 4, 2, 1, 0]]}, "finite"),
        ({"boxes": [[0, 0, 1, 4, -2, 1, 0]]}, "positive"),
        ({"scores": [np.inf]}, "scores must be finite, got .inf."),
        ({"labels": ["lorry"]}, "label must be one of"),
        ({"labels": [7]}, "labels must be 0..3"),
        ({"ids": [-1]}, "ids must not be negative, got -1"),
        ({"ids": [0.5]}, "ids must be one whole number"),
        ({"velocities": [[np.inf, 0, 0]]}, "velocities must be at most 10000 m/s, got inf"),
        ({"velocities": [[0, 1e5, 0]]}, "velocities must be at most 10000 m/s, got 100000"),
        ({"boxes": [[0, 1e300, 1, 4, 2, 1, 0]]}, "boxes must lie within"),
    ],
)
def test_what_an_instant_refuses(change, reason):
    fields = {"boxes": [[0, 0, 1, 4, 2, 1, 0]], "labels": [0], "scores": [0.5], "ids": [1]}
    with pytest.raises(ValueError, match=reason):
        Instant(0.0, **{name: np.array(value) for name, value in (fields | change).items()})


def test_a_box_at_the_limit_of_maps_is_taken():
    limit = MAX_COORDINATE_M
    instant = Instant(0.0, np.array([[-limit, limit, 1, 4, 2, 1, 0]]), np.zeros(1), np.ones(1))
    assert instant.boxes[0, :2].tolist() == [-limit, limit]


def test_columns_of_other_shapes_are_refused():
    box = np.array([[0, 0, 1, 4, 2, 1, 0]])
    for change in ({"velocities": np.ones(3)}, {"ids": np.ones((1, 1), int)}):
        with pytest.raises((ValueError, TypeError)):
            Instant(0.0, box, np.array([0]), np.array([1.0]), **change)


def test_two_objects_of_one_id_are_refused():
    box = [0, 0, 1, 4, 2, 1, 0]
    with pytest.raises(ValueError, match="must differ, got 4 twice"):
        make(0.0, [box, box], [0, 0], [1, 1], [4, 4])


def test_detections_without_ids_are_objects_of_one_instant(tmp_path):
    detections = Detections(boxes_at(0, np.arange(3)), np.ones(3), np.zeros(3, int))
    instants = [Instant.from_detections(START_S + k, detections) for k in range(2)]
    path = write("openlabel", tmp_path, instants)
    assert list(json.loads(path.read_text())["openlabel"]["objects"]) == list("012345")


def test_a_name_a_place_and_a_package_that_are_missing(tmp_path, without_packages):
    with pytest.raises(ValueError, match="no writer 'kml': choose among kitti-tracking"):
        open_writer("kml", tmp_path / "a").__enter__()
    with pytest.raises(ValueError, match="mf-json needs the recording's place on earth"):
        open_writer("mf-json", tmp_path / "a").__enter__()
    for name, standard in STANDARDS.items():
        if standard.packages:
            without_packages(*(module for module, _ in standard.packages))
            extra = "cpm" if name == "cpm" else "exchange"
            with pytest.raises(ImportError, match=rf"needs .*: pip install coview\[{extra}\]"):
                open_writer(name, tmp_path / "a", origin=ORIGIN).__enter__()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("time_s", [-1.0, 1e12])
def test_clocks_outside_their_range_are_refused(time_s, tmp_path):
    instant = make(time_s, [[0, 0, 1, 4, 2, 1, 0]], [0], [1.0])
    with pytest.raises(ValueError, match="seconds since 1970, got"):
        write("mf-json", tmp_path, [instant])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.one_in(3)
@pytest.mark.filterwarnings("ignore:.*which a killed run left")
@pytest.mark.parametrize("name", READERS)
def test_a_kill_leaves_nothing_under_the_name(name, tmp_path):
    for module, _ in find_standard(name).packages:
        pytest.importorskip(module)
    path = tmp_path / f"out{find_standard(name).ending}"
    program = f"""
import os, signal
import numpy as np
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import open_writer
with open_writer({name!r}, {str(path)!r}, origin=GeoOrigin(1.0, 2.0)) as writer:
    for k in range(50):
        box = np.array([[k, 0, 1, 4, 2, 1, 0]])
        writer.write(Instant(k, box, np.array([0]), np.array([1.0]), np.array([k])))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = subprocess.run([sys.executable, "-c", program], env=os.environ, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not path.exists()
    write(name, tmp_path, traffic(2))  # takes over what the killed run left
    assert path.exists()


def extreme(seed: int) -> list[dict]:
    """Fields of instants with something wrong or rare in them, by a seed."""
    rng = np.random.default_rng(seed)
    instants = []
    time_s = START_S
    for k in range(3):
        count = int(rng.choice([0, 1, 3, 20]))
        low, high = [-500, -500, -3, 0.05, 0.05, 0.05, -9], [500, 500, 9, 30, 4, 5, 9]
        boxes = rng.uniform(low, high, (count, 7))
        fields: dict[str, Any] = {
            "boxes": boxes,
            "labels": rng.integers(0, 4, count),
            "scores": rng.uniform(-2, 3, count),
            "ids": rng.permutation(10**6)[:count],
            "velocities": rng.normal(0, 40, (count, 3)),
        }
        change = rng.integers(0, 12) if k == 1 else 99
        wrong = rng.choice([np.nan, np.inf, -np.inf, 1e300, 0.0, -1.0])
        if count and change in (0, 1, 2):
            boxes[rng.integers(count), rng.integers(7)] = wrong
        elif count and change in (3, 4):
            fields["velocities"][rng.integers(count)] = wrong
        elif count and change == 5:
            fields["scores"][rng.integers(count)] = wrong
        elif change == 6:
            time_s -= rng.choice([0.0, 0.1, 1e6])
        elif change == 7:
            time_s = rng.choice([np.nan, np.inf, -1.0, 1e12])
        elif count > 1 and change == 8:
            fields["ids"][0] = fields["ids"][1]
        elif change == 9:
            fields["ids"] = None
        elif count and change == 10:
            fields["velocities"][:] = np.nan
        instants.append({"time_s": time_s, **fields})
        time_s = START_S + 0.1 * (k + 1)
    return instants


@pytest.mark.one_in(3)
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", [name for name in READERS if name != "mf-json"])
@pytest.mark.parametrize("seeds", [range(12), pytest.param(range(12, 200), marks=pytest.mark.slow)])
def test_extreme_inputs_give_one_line_or_a_sound_file(name, seeds, tmp_path):
    refused = []
    for seed in seeds:
        folder = tmp_path / str(seed)
        try:
            instants = [Instant(**fields) for fields in extreme(seed)]
            path = write(name, folder, instants)
        except ValueError as error:
            refused.append(str(error))
            assert not folder.exists() or list(folder.iterdir()) == []
            continue
        counts = [len(rows) for _, _, rows in READERS[name](path)]
        expected = [len(instant) for instant in instants]
        if name == "kitti-tracking":
            expected = [count for count in expected if count]
        assert counts == expected
    assert len(seeds) / 8 < len(refused) < len(seeds) * 7 / 8
    assert all("\n" not in text for text in refused)
