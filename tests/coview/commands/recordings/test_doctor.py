"""coview doctor: exit codes."""

from coview.exits import SUSPECTED


def test_it_has_nothing_to_say_of_a_healthy_recording_and_much_of_a_broken_one(recording, tmp_path, run):
    assert run("doctor", recording, "--json")[:2] == (0, "[]\n")
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(recording.read_bytes()[:5000])
    code, out, _ = run("doctor", broken)
    assert code == SUSPECTED
    assert out.startswith("error: ")
