import pytest
import torch

from placement_env.rl.maps.training_state import TrainingState, cosine


def begun(path, features=2, **identity):
    torch.manual_seed(features)
    network = torch.nn.Linear(features, 1)
    return network, TrainingState(path, {"seed": 0, **identity}, {"network": network}, every_s=10.0)


def test_it_goes_on_where_it_was(tmp_path):
    network, state = begun(tmp_path / "new" / "state.pt")
    assert state.counts == {}
    with torch.no_grad():
        network.weight.fill_(7.0)
    state.save(steps=3, losses={"ap": 0.5})
    again, later = begun(tmp_path / "new" / "state.pt")
    assert again.weight.tolist() == [[7.0, 7.0]]
    assert later.counts == {"steps": 3, "losses": {"ap": 0.5}}


def test_a_checkpoint_is_due_after_a_while(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("placement_env.rl.maps.training_state.time.monotonic", lambda: now[0])
    _, state = begun(tmp_path / "state.pt")
    assert not state.due
    now[0] = 110.0
    assert state.due
    state.save(steps=1)
    assert not state.due
    now[0] = 119.0
    assert not state.due


def test_files_of_something_else(tmp_path):
    path = tmp_path / "state.pt"
    begun(path)[1].save(steps=1)
    with pytest.raises(ValueError, match=r"state.pt is of other seed and width: choose another folder or remove it"):
        begun(path, seed=1, width=3)
    with pytest.raises(ValueError, match="remove it to begin anew"):
        begun(path, 3)
    torch.save({"seed": 0, "network": torch.nn.Linear(2, 1).state_dict()}, path)
    with pytest.raises(ValueError, match=r"is no checkpoint of this training .* remove it to begin anew"):
        begun(path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match="remove it to begin anew"):
        begun(path)


def test_learning_rates_fall():
    assert [cosine(share) for share in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 0.505, 0.01])
