"""What the commands on recordings print as JSON, pinned for one small recording and for it in two
other layouts.

Tolerances are those that another processor keeps: one ray at an edge may fall the other way.
"""

import json

import pytest

AREA = ("--area", -20, -20, 20, 20)
NEAR = {"rel": 0.02, "abs": 0.02}
VEHICLES = {  # by scheme and number of sensors: AP at IoU 0.5, kbit per sensor, Mbit/s at 10 Hz
    ("early", 6): (1.0, 532.62, 31.957),
    ("early", 2): (0.529, 414.98, 8.3),
    ("late", 6): (1.0, 2.22, 0.133),
    ("late", 2): (0.444, 1.98, 0.04),
}
CLOUDS = {  # by scheme, protocol, measure and group: AP of vehicles, how many there are to find
    ("early", "ours", "BEV 0.5", "all"): (0.6, 15),
    ("early", "ours", "3D 0.7", "all"): (0.6, 15),
    ("early", "ours", "BEV 0.5", "20-35 m"): (0.556, 9),
    ("late", "ours", "BEV 0.7", "all"): (0.496, 15),
    ("late", "KITTI R40", "3D 0.7", "all"): (0.396, 15),
    ("late", "nuScenes", "centre, mean", "all"): (0.515, 15),
}


@pytest.fixture(scope="session")
def layouts(recording, tmp_path_factory):
    """The recording as a plain folder of clouds and as KITTI."""
    from toolkit.datasets.recording_views import read
    from toolkit.datasets.recordings import write_recording

    folder = tmp_path_factory.mktemp("pinned")
    for layout in ("folder", "kitti"):
        write_recording(read(recording), folder / layout, layout)
    return folder


@pytest.fixture
def printed(run):
    def printed(*arguments):
        code, out, err = run(*arguments, "--json")
        assert code == 0, err
        return json.loads(out)

    return printed


def near(content, **tolerances):
    return pytest.approx(content, **(NEAR | tolerances))


def test_evaluate(recording, tmp_path, printed):
    arguments = (
        "--detector",
        "voxelnet",
        "--sensors",
        "all",
        "0,2",
        "--frames",
        2,
        "--rate",
        10,
        "--iou",
        0.5,
    )
    found = printed(
        "evaluate", recording, *arguments, "--schemes", "early", "late", "--out", tmp_path
    )
    rows = {(row["scheme"], len(row["sensors"]), row["label"]): row for row in found["rows"]}
    assert len(found["rows"]) == len(found["classes"]) == len(rows)
    for (scheme, sensors), (ap, kbit, mbit) in VEHICLES.items():
        row = rows[scheme, sensors, "vehicle"]
        assert (row["ap"], row["truths"], row["kbit_per_sensor"]) == (
            near(ap, abs=0.1),
            17,
            near(kbit, abs=0.5),
        )
        (load,) = [
            each
            for each in found["loads"]
            if (each["scheme"], len(each["sensors"])) == (scheme, sensors)
        ]
        assert load["mbit_per_s"] == near(mbit)
    assert sum(found["classes"][0]["reliability"]["count"]) == near(17, abs=3)


def test_evaluate_clouds(layouts, tmp_path, printed):
    arguments = (
        *(
            "--schemes",
            "early",
            "late",
            "--classes",
            "vehicle",
            "--area",
            -40,
            -40,
            40,
            40,
            "--still",
            "--frames",
            2,
        ),
        *("--sensors", "d0,d2"),
    )
    where = ("--layout", "folder", "--out", tmp_path)
    found = printed("evaluate", layouts / "folder", *where, *arguments)
    aps = {
        (row["scheme"], row["protocol"], row["measure"], row["among"]): row
        for row in found["breakdown"]
    }
    assert len(aps) == len(found["breakdown"]) == 2 * 29
    for key, (ap, truths) in CLOUDS.items():
        assert (aps[key]["ap"], aps[key]["truths"]) == (near(ap, abs=0.15), truths), key
    kbit = {scheme: figures["kbit_per_sensor"] for scheme, figures in found["schemes"].items()}
    assert kbit == near({"early": 930.77, "late": 1.86}, abs=0.5)
    assert found["schemes"]["early"]["samples"] == 2


def test_detect_and_convert(recording, layouts, tmp_path, printed):
    out = tmp_path / "found.json"
    where = (layouts / "kitti", "--layout", "kitti", "--level", "none", "--frames", 1)
    assert printed("detect", *where, "--out", out)["detections"] == near(20, abs=4)
    assert len(json.loads(out.read_text())["samples"][0]["objects"]) == near(20, abs=4)
    converted = printed("convert", recording, "--to", "hdf5", "--out", tmp_path / "c.hdf5")
    assert (converted["samples"], converted["problems"]) == (4, {})


@pytest.mark.slow
def test_survey_and_doctor(recording, layouts, printed):
    found = printed("survey", recording, "--sensors", "all", "0,2")
    assert found["objects_per_frame"] == near(
        {"vehicle": 9.0, "cyclist": 1.75, "pedestrian": 7.25, "heavy": 1.0}
    )
    assert found["kbit_per_sensor"] == near(540.6)
    assert found["unseen"] == near({"0,1,2,3,4,5": 0.0, "0,2": 0.361}, abs=0.05)
    assert found["classes"]["vehicle"]["sets"]["0,2"] == near(
        {"mean_points": 211.6, "median_points": 30.0, "unseen": 0.361}, rel=0.1, abs=0.05
    )
    clouds = printed("survey", layouts / "folder", "--layout", "folder")
    assert clouds["points_per_cloud"] == near(
        {"d0": 17221, "d1": 16224, "d2": 17043, "d3": 16129, "d4": 17386, "d5": 16451}
    )
    assert clouds["objects_per_frame"] == near(
        {"vehicle": 12.75, "cyclist": 1.75, "pedestrian": 9.5, "heavy": 1.0}
    )
    assert clouds["classes"]["vehicle"]["sets"]["0,1,2,3,4,5"]["mean_points"] == near(546.5)
    assert (
        printed("doctor", recording)
        == printed("doctor", layouts / "folder", "--layout", "folder")
        == []
    )


def test_pack_and_fuse(recording, layouts, tmp_path, printed):
    from models.training.packed import PackedFrames

    assert printed("pack", recording, "--out", tmp_path / "images")["frames"] == 4
    packed = printed(
        "pack",
        layouts / "folder",
        "--layout",
        "folder",
        "--still",
        *AREA,
        "--out",
        tmp_path / "clouds",
    )
    assert packed["frames"] == 4
    points = [
        sum(map(len, PackedFrames(tmp_path / name).points(0, None)))
        for name in ("images", "clouds")
    ]
    assert points == near([29736, 25825])
    clouds = [layouts / "folder" / sensor / "000000.pcd" for sensor in ("d0", "d1")]
    for number, cloud in enumerate(clouds):
        (tmp_path / f"d{number}.pcd").write_bytes(cloud.read_bytes())
    poses = [
        line.split(maxsplit=1)
        for line in (layouts / "folder" / "poses.txt").read_text().splitlines()[:2]
    ]
    (tmp_path / "poses.txt").write_text("".join(f"{name[:2]} {pose}\n" for name, pose in poses))
    fused = printed(
        "fuse", *sorted(tmp_path.glob("d?.pcd")), "--poses", tmp_path / "poses.txt", *AREA
    )
    assert (fused["files"], fused["points"]) == (2, near(5737))
