import numpy as np
import pytest

from toolkit.datasets.layouts.kitti import NONE_SHOWN, kitti, kitti_text, write_kitti
from toolkit.frame import Frame, ImageWedge
from toolkit.objects import Objects

# The axes of a camera that looks along the lidar's x, and 0.27 m behind, 0.08 m below it, as in the
# set.
CALIB = """P0: 700 0 600 0 0 700 180 0 0 0 1 0
P2: 700 0 600 0 0 700 180 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27

"""
# ahead 20.27 m in the lidar, 2 m to the left, its floor 1.65 m below the camera; it faces right: ry
# = 0
CAR = "Car 0.00 0 -1.57 100 100 200 200 1.50 1.60 4.00 -2.00 1.65 20.00 0.00"
DONT_CARE = "DontCare -1 -1 -10 500.00 150.00 700.00 200.00 -1 -1 -1 -1000 -1000 -1000 -10"


def folder(tmp_path, labels, calib=CALIB):
    for name, content in (("label_2/000007.txt", labels), ("calib/000007.txt", calib)):
        (tmp_path / "training" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "training" / name).write_text(content)
    (tmp_path / "training/velodyne").mkdir(exist_ok=True)
    points = np.array([[20, 2, -1, 0.5], [np.nan, 0, 0, 0], [0, 0, 0, 0]], "<f4")
    points.tofile(tmp_path / "training/velodyne/000007.bin")
    return tmp_path


def only(tmp_path, labels, calib=CALIB):
    (sample,) = kitti(folder(tmp_path, labels, calib))
    return sample


def test_labels_by_hand_and_what_cannot_be_is_counted(tmp_path):
    """The floor's centre in the camera's frame, h w l, and ry = 0 faces right, which is yaw -90
    degrees."""
    sample = only(tmp_path, CAR + "\n")
    np.testing.assert_allclose(
        sample.objects.boxes[0], [20.27, 2.0, -0.08 - 1.65 + 0.75, 4.0, 1.6, 1.5, -np.pi / 2]
    )
    assert sample.name == "000007"
    assert sample.categories == ("Car",)
    sample = only(tmp_path, CAR)
    assert sample.points().tolist() == [[20, 2, -1]]
    assert sample.clouds[0].intensity.tolist() == [0.5]
    assert sample.problems == {"points with NaN or infinite numbers": 1, "points of no return": 1}
    flat = CAR.replace("1.50 1.60 4.00", "0.00 1.60 4.00")
    sample = only(
        tmp_path,
        "\n".join([CAR, CAR, flat, CAR.replace("20.00", "nan"), CAR.replace("Car", "Misc")]),
    )
    assert len(sample.objects) == 1
    assert sample.others.categories == ("Misc",)
    assert {key: n for key, n in sample.problems.items() if "points" not in key} == {
        "doubled labels": 1,
        "boxes of no size": 1,
        "labels with NaN or infinite numbers": 1,
        "labels of other kinds than ours": 1,
    }


def test_a_calibration_that_shows_none_of_the_labels_is_said(tmp_path):
    assert NONE_SHOWN not in only(tmp_path, CAR).problems
    upside_down = CALIB.replace(
        "P2: 700 0 600 0 0 700 180 0 0 0 1 0", "P2: 0 0 0 0 0 0 0 0 0 0 -1 0"
    )
    assert only(tmp_path, f"{CAR}\n{DONT_CARE}", upside_down).problems[NONE_SHOWN] == 1


@pytest.mark.parametrize(
    ("ry", "yaw"), [(-np.pi / 2, 0.0), (np.pi / 2, np.pi), (0.3, -np.pi / 2 - 0.3)]
)
def test_ry_turns_the_other_way_from_the_cameras_x(tmp_path, ry, yaw):
    sample = only(tmp_path, CAR.rsplit(" ", 1)[0] + f" {ry}")
    assert np.cos(sample.objects.boxes[0, 6] - yaw) == pytest.approx(1.0)


def test_labels_are_complete_in_the_image_as_wide_as_it_is(tmp_path):
    sample = only(tmp_path, f"{CAR}\n{DONT_CARE}\n")
    assert len(sample.objects) == 1
    ahead, behind, aside = [30.0, 0, -0.08], [-30.0, 0, 0], [5.0, 30, 0]
    boxes = np.array(
        [[*place, 2.0, 1.0, 1.0, 0] for place in ([20.0, 2, -1], behind, aside, ahead)]
    )
    # the last is shown at u = 600, v = 180, in the region of DontCare
    assert sample.complete.covers(boxes).tolist() == [True, False, False, False]
    folder(tmp_path, CAR)
    image = tmp_path / "training/image_2/000007.png"
    image.parent.mkdir()
    image.write_bytes(
        b"\x89PNG\r\n\x1a\n" + bytes(8) + (640).to_bytes(4, "big") + (480).to_bytes(4, "big")
    )
    (sample,) = kitti(tmp_path)
    assert [vars(sample.complete)[side] for side in ("width", "height")] == [640, 480]
    calib = CALIB.replace("R0_rect:", "R_rect").replace("Tr_velo_to_cam:", "Tr_velo_cam")
    assert only(tmp_path, CAR, calib).objects.boxes[0, 0] == pytest.approx(20.27)


@pytest.mark.parametrize(
    ("labels", "calib", "names"),
    [
        ("Car 0 0", CALIB, r"000007.txt .*15 or 16 entries, got 3"),
        (CAR.replace("1.50", "tall"), CALIB, r"000007.txt .*must be a number, got 'tall'"),
        (CAR, CALIB.replace("P2", "P9"), r"calib.000007.txt .*it has no entry P2"),
        (CAR, CALIB.replace("R0_rect: 1 0 0 0 1", "R0_rect: 1 0 0 0 5"), "must turn by a rotation"),
    ],
)
def test_damage_is_named(tmp_path, labels, calib, names):
    with pytest.raises(ValueError, match=names):
        only(tmp_path, labels, calib)


def test_what_is_written_is_kittis_with_camera_and_ignored_regions(tmp_path):
    sample = only(tmp_path, f"{CAR}\n{DONT_CARE}\n")
    write_kitti([sample], tmp_path / "again")
    (again,) = kitti(tmp_path / "again")
    assert isinstance(again.complete, ImageWedge)
    assert again.complete.ignored == ((500.0, 150.0, 700.0, 200.0),)
    np.testing.assert_allclose(again.complete.projection, sample.complete.projection, atol=1e-6)
    box = np.array([[20.0, 2, -1, 4, 1.6, 1.5, -np.pi / 2]])
    sample = Frame.of_clouds("a", (), Objects(box, np.array([3])))
    words = kitti_text(sample).split()
    assert words[0] == "Truck"
    assert len(words) == 15
    assert [float(word) for word in words[8:]] == pytest.approx(
        [1.5, 1.6, 4.0, -2.0, 1.75, 20.0, 0.0], abs=1e-6
    )
