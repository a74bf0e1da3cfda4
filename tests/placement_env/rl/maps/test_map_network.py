import numpy as np
import pytest
import torch

from placement_env.rl.maps.map_network import MapNetwork, Prospects


@pytest.fixture
def network() -> MapNetwork:
    torch.manual_seed(0)
    return MapNetwork(8)


def inputs(candidates: int = 6, cells: int = 9) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(1)
    shapes = ((cells, 8), (candidates, cells, 5), (candidates, 10))
    return tuple(torch.rand(shape, generator=generator) * 0.8 for shape in shapes)


def test_the_order_of_candidates_and_cells_does_not_matter(network):
    channels, view, features = inputs()
    seen = network.prospects(channels, view, features)
    candidates, cells = torch.randperm(6), torch.randperm(9)
    other = network.prospects(channels[cells], view[candidates][:, cells], features[candidates])
    chosen = torch.zeros(1, 6)
    chosen[0, [1, 4]] = 1
    one, two = network.next_ap(seen, chosen).detach(), network.next_ap(other, chosen[:, candidates]).detach()
    assert torch.allclose(two[0], one[0, candidates], atol=1e-6)
    assert torch.allclose(other.log_kbit, seen.log_kbit[candidates], atol=1e-6)


def test_at_first_cells_count_as_the_map_says(network):
    channels, view, features = inputs()
    weight = network.prospects(channels, view, features).weight.detach().numpy()
    traffic = channels[:, 6].numpy() / (1 - channels[:, 6].numpy())
    assert weight == pytest.approx(traffic / traffic.sum(), rel=1e-3)
    assert weight.sum() == pytest.approx(1)


def test_more_evidence_is_never_worse(network):
    evidence = torch.logspace(-8, 8, 60)
    hit = network.hit(evidence).detach().numpy()
    assert (np.diff(hit) >= -1e-7).all()
    assert 0 <= hit.min() < 0.01 < 0.99 < hit.max() <= 1
    seen = network.prospects(*inputs())
    empty, one = torch.zeros(1, 6), torch.eye(6)[:1]
    assert (network.next_ap(seen, one) >= network.next_ap(seen, empty)[0, 0] - 1e-6).all()


def test_ap_of_known_evidence(network):
    """Two cells of equal weight, of which one is surely hit and the other surely not."""
    with torch.no_grad():
        network.false_alarms.fill_(0.0)  # κ is a half
    evidence = torch.tensor([[1e12, 0.0]])
    assert float(network.ap(evidence, torch.tensor([0.5, 0.5]))) == pytest.approx(0.5 * (1 - 0.5 * 0.5), abs=0.01)
    seen = Prospects(torch.tensor([[1e12, 0.0], [0.0, 1e12]]), torch.tensor([0.5, 0.5]), *torch.zeros(2, 2))
    both = network.next_ap(seen, torch.tensor([[1.0, 0.0]]))
    assert both[0].detach().tolist() == pytest.approx([0.375, 1.0], abs=0.02)


def test_evidence_of_a_set_adds_up(network):
    seen = network.prospects(*inputs())
    rows = torch.tensor([[1.0, 1, 0, 0, 0, 0]])
    expected = network.ap(seen.evidence[0] + seen.evidence[1] + seen.evidence[3], seen.weight)
    assert float(network.next_ap(seen, rows)[0, 3]) == pytest.approx(float(expected), abs=1e-6)
