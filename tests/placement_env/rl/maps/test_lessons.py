from dataclasses import fields

import numpy as np
import pytest

from placement_env.rl.maps.lessons import LARGEST_SET, RANDOM_SETS, Lesson, lesson_of, next_scores, objective_of


@pytest.fixture(scope="module")
def junction(made_up):
    return made_up(2, 4, 3)


def test_scores_of_the_next_sensor(junction):
    objective = objective_of(junction)
    chosen = np.zeros((2, 12), np.bool_)
    chosen[1, 4] = True
    ap = next_scores(objective, chosen)
    for c in range(12):
        assert ap[0, c] == pytest.approx(objective.score([c]).ap)
    taken = junction.candidates.mount == junction.candidates.mount[4]
    assert np.isnan(ap[1]).tolist() == taken.tolist()
    free = int(np.flatnonzero(~taken)[-1])
    assert ap[1, free] == pytest.approx(objective.score([4, free]).ap)


def test_a_lesson_has_greedy_prefixes_and_random_sets(junction):
    lesson = lesson_of(junction, 0)
    assert 4 < len(lesson.sets) <= 4 + RANDOM_SETS
    assert not lesson.sets[0].any()
    first = int(np.nanargmax(lesson.ap[0]))
    assert any(row.sum() == 1 and row[first] for row in lesson.sets)
    for row, ap in zip(lesson.sets, lesson.ap, strict=True):
        mounts = junction.candidates.mount[row]
        assert len(set(mounts.tolist())) == row.sum() < min(LARGEST_SET, 4)
        assert np.isfinite(ap).tolist() == (~np.isin(junction.candidates.mount, mounts)).tolist()
    assert lesson.kbit == pytest.approx(objective_of(junction).sent)
    assert lesson.view.shape == (12, len(lesson.channels), 5)


def test_sets_that_nobody_may_join_teach_nothing(made_up):
    """At a junction with one mount, every set but the empty one."""
    lesson = lesson_of(made_up(0, 1, 3), 0)
    assert lesson.sets.tolist() == [[False] * 3]
    assert np.isfinite(lesson.ap).all()


def test_vehicles_are_in_their_cells_and_hit_as_the_surrogate_says(junction):
    lesson = lesson_of(junction, 0)
    assert lesson.alone.shape == (12, len(lesson.cell)) == (12, 40)
    assert lesson.cell.max() < len(lesson.channels)
    seen = junction.visibility.points > 0
    assert (lesson.alone[seen] > 0).all()
    assert (lesson.alone[~seen] == 0).all()
    ap = np.array([objective_of(junction).score([c]).recall for c in range(12)])
    assert lesson.alone.astype(float).mean(axis=1) == pytest.approx(ap, abs=1e-3)


def test_lessons_are_kept_in_files(junction, tmp_path):
    lesson = lesson_of(junction, 0)
    lesson.save(tmp_path / "lesson.npz")
    again = Lesson.load(tmp_path / "lesson.npz")
    for field in fields(Lesson):
        assert np.array_equal(getattr(again, field.name), getattr(lesson, field.name), equal_nan=field.name == "ap"), (
            field.name
        )
    (tmp_path / "lesson.npz").write_bytes((tmp_path / "lesson.npz").read_bytes()[:-1])
    with pytest.raises(ValueError, match="does not fit its checksum"):
        Lesson.load(tmp_path / "lesson.npz")
    junction.visibility.save(tmp_path / "other.npz")
    with pytest.raises(ValueError, match="must hold alone, ap, cell"):
        Lesson.load(tmp_path / "other.npz")
