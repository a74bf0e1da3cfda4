import pytest
import torch

from models.tensor_files import load_tensors


class Harmful:
    def __reduce__(self):
        return print, ("executed",)


def test_tensors_are_read_and_nothing_is_executed(tmp_path, capsys):
    torch.save({"a": torch.arange(3), "b": [1, "x"]}, tmp_path / "a.pt")
    read = load_tensors(tmp_path / "a.pt")
    assert read["a"].tolist() == [0, 1, 2]
    assert read["b"] == [1, "x"]
    torch.save({"a": Harmful()}, tmp_path / "b.pt")
    with pytest.raises(ValueError, match=r"b\.pt is damaged or no checkpoint of tensors alone"):
        load_tensors(tmp_path / "b.pt")
    assert "executed" not in capsys.readouterr().out


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_a_file_that_is_cut_off_is_refused_in_one_line(tmp_path, share):
    torch.save({"a": torch.arange(3000)}, tmp_path / "a.pt")
    whole = (tmp_path / "a.pt").read_bytes()
    (tmp_path / "a.pt").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"a\.pt is damaged") as error:
        load_tensors(tmp_path / "a.pt")
    assert "\n" not in str(error.value)
    with pytest.raises(FileNotFoundError):
        load_tensors(tmp_path / "b.pt")
