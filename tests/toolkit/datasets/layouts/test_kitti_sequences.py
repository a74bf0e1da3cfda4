"""KITTI's tracking labels: rows by hand, and against motrics, which reads them in the camera."""

import numpy as np
import pytest

from toolkit.datasets.layouts.kitti_sequences import MISSING_CLOUDS, kitti_sequence
from toolkit.datasets.recordings import guess_layout, open_recording
from toolkit.frame import ImageWedge

pytestmark = pytest.mark.filterwarnings("ignore:.*is read as layout kitti-tracking")
# axes of a camera that looks along the lidar's x, 0.27 m behind and 0.08 m below it
CALIB = """P2: 700 0 600 0 0 700 180 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
Tr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 0
"""
# ahead 20.27 m in the lidar, 2 m to the left; it faces right
CAR = "0 4 Car 0 0 -1.57 100 100 200 200 1.50 1.60 4.00 -2.00 1.65 20.00 0.00"
LATER = "2 4 Car 0 0 -1.57 100 100 200 200 1.50 1.60 4.00 -2.00 1.65 21.00 0.10"
WALKER = "2 9 Pedestrian 0 1 -1.57 100 100 200 200 1.80 0.60 0.60 3.00 1.65 12.00 1.00"
DONT_CARE = "2 -1 DontCare -1 -1 -10 500 150 700 200 -1 -1 -1 -1000 -1000 -1000 -10"


def folder(tmp_path, labels, calib=CALIB, sequences=("0007",), frames=3):
    for name in sequences:
        clouds = tmp_path / "training" / "velodyne" / name
        clouds.mkdir(parents=True)
        for k in range(frames):
            np.array([[20, 2, -1, 0.5]], "<f4").tofile(clouds / f"{k:06d}.bin")
        for kind, content in (("label_02", labels), ("calib", calib)):
            if content is not None:
                (tmp_path / "training" / kind).mkdir(exist_ok=True)
                (tmp_path / "training" / kind / f"{name}.txt").write_text(content)
    return tmp_path


def test_labels_by_hand(tmp_path):
    root = folder(tmp_path, "\n".join([LATER, CAR, WALKER, DONT_CARE, ""]))
    assert guess_layout(root) == "kitti-tracking"
    first, second, third = open_recording(root)
    np.testing.assert_allclose(
        first.objects.boxes[0], [20.27, 2.0, -0.08 - 1.65 + 0.75, 4.0, 1.6, 1.5, -np.pi / 2]
    )
    assert first.name == "000000"
    assert first.objects.ids.tolist() == [4]
    assert len(second.objects) == 0
    assert third.objects.ids.tolist() == [4, 9]
    assert third.categories == ("Car", "Pedestrian")
    assert isinstance(third.complete, ImageWedge)
    assert third.complete.ignored == ((500, 150, 700, 200),)
    assert np.isnan(third.time)
    assert third.problems == {}
    sequence = root / "training" / "velodyne" / "0007"
    assert len(kitti_sequence(sequence)[2].objects) == 2


def test_motrics_reads_the_same(tmp_path):
    motrics = pytest.importorskip("motrics")
    root = folder(tmp_path, "\n".join([LATER, CAR, WALKER, DONT_CARE]))
    truth, _ = motrics.load_kitti_3d_gt(root / "training" / "label_02" / "0007.txt")
    for number, frame in enumerate(open_recording(root)):
        ids, boxes = truth.get(number, ((), ()))[:2]
        assert frame.objects.ids.tolist() == list(ids)
        for box, (x, y, z, *sizes, turn) in zip(frame.objects.boxes, boxes, strict=True):
            expected = [z + 0.27, -x, -y - 0.08, *sizes]
            np.testing.assert_allclose(box[:6], expected, atol=1e-9)
            assert box[6] == pytest.approx(-turn - np.pi / 2)


def test_what_a_sequence_lacks(tmp_path):
    root = folder(tmp_path, CAR + "\n" + CAR.replace("0 4", "8 4", 1), sequences=("0001", "0002"))
    with pytest.raises(ValueError, match="holds 2 sequences, 0001, 0002: give one, such as"):
        open_recording(root)
    frames = list(open_recording(root / "training" / "velodyne" / "0002", "kitti-tracking"))
    assert frames[0].problems == {MISSING_CLOUDS: 1}
    (root / "training" / "calib" / "0002.txt").unlink()
    with pytest.raises(FileNotFoundError, match="no calibration"):
        open_recording(root / "training" / "velodyne" / "0002", "kitti-tracking")
    (root / "training" / "label_02" / "0002.txt").unlink()
    unlabelled = open_recording(root / "training" / "velodyne" / "0002", "kitti-tracking")
    assert len(unlabelled[0].objects) == 0
    with pytest.raises(FileNotFoundError, match="no sequence of KITTI's tracking"):
        kitti_sequence(tmp_path / "training" / "calib")


@pytest.mark.parametrize(
    ("labels", "reason"),
    [
        (CAR.removeprefix("0 4 "), "17 or 18 entries, got 15"),
        (CAR.replace("0 4", "x 4", 1), "frame must be a number, got 'x'"),
        (CAR.replace("0 4", "0 4.5", 1), "track must be a whole number, got '4.5'"),
        (CAR.replace("0 4", "nan 4", 1), "frame must be a whole number, got 'nan'"),
        (CAR.replace("1.50", "high"), "must be a number, got 'high'"),
        ("\x00\xff", "list of labels"),
    ],
)
def test_damage_is_named(tmp_path, labels, reason):
    root = folder(tmp_path, labels)
    with pytest.raises(ValueError, match=reason) as raised:
        open_recording(root)
    assert "0007.txt" in str(raised.value)


def test_damaged_calibrations_and_clouds_are_named(tmp_path):
    root = folder(tmp_path, CAR, calib="P2: 1 2 3\n")
    with pytest.raises(ValueError, match=r"calib.*0007\.txt is no calibration"):
        open_recording(root)
    (root / "training" / "calib" / "0007.txt").write_text(CALIB)
    (root / "training" / "velodyne" / "0007" / "000000.bin").write_bytes(b"12345")
    with pytest.raises(ValueError, match=r"000000\.bin must hold rows"):
        open_recording(root)[0]
    (root / "training" / "velodyne" / "0007" / "last.bin").write_bytes(b"")
    with pytest.raises(ValueError, match="the name of a cloud must be a number, got 'last'"):
        open_recording(root)
