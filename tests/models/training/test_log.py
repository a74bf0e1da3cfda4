"""The log of a training: rows that are added, cut and read as curves."""

from models.training import log


def test_a_log_forgets_what_came_after_the_checkpoint(tmp_path):
    path = tmp_path / "log.csv"
    log.cut(path, 5)
    for step in (5, 10, 15):
        log.add(path, step, step / 10, {"box": 1.0 / step})
    with path.open("a") as file:
        file.write("20,2.0,bo")  # killed in the middle of a line
    log.cut(path, 10)
    assert log.curves(path) == {"box": ([0.5, 1.0], [0.2, 0.1])}
    path.write_text("")
    log.cut(path, 10)
    log.add(path, 1, 0.1, {"box": 1.0})
    assert log.curves(path) == {"box": ([0.1], [1.0])}


def test_curves_come_in_the_order_in_which_they_first_appear(tmp_path):
    path = tmp_path / log.LOG
    log.add(path, 1, 0.5, {"residuals": 2.0, "class": 3.0})
    log.add(path, 2, 1.0, {"AP@0.7": 0.25, "class": 1.0})
    assert path.read_text().splitlines()[:2] == ["step,epoch,name,value", "1,0.5000,residuals,2.0"]
    found = log.curves(path)
    assert list(found) == ["residuals", "class", "AP@0.7"]
    assert found["class"] == ([0.5, 1.0], [3.0, 1.0])
