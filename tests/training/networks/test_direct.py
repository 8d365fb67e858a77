import torch

from tests.training import tiny
from training.networks.blocks import ModulatedPlaneBlock
from training.networks.direct import DirectConfig, DirectNetwork

CONFIG = DirectConfig(shape=tiny.RECONSTRUCTION, hidden=8)


def network() -> DirectNetwork:
    torch.manual_seed(0)
    return DirectNetwork(CONFIG).eval()


def test_it_begins_as_the_reconstruction_it_is_given() -> None:
    direct = network()
    direct.shape.load_state_dict(tiny.reconstruction_network(seed=1).state_dict())
    view = torch.rand(2, 2, 64, 64, 64).round()
    with torch.no_grad():
        torch.testing.assert_close(direct(view, tiny.conditions(2)), tiny.reconstruction_network(seed=1)(view))


def test_every_size_learns_of_the_load() -> None:
    direct = network()
    for load in direct.loads:
        assert isinstance(load.block, ModulatedPlaneBlock)
        for weight in (load.shown.weight, load.block.modulation.weight, load.block.norm.weight):
            torch.nn.init.normal_(weight)
    weak, strong = tiny.conditions(2), tiny.conditions(2, log_load=-1.5)
    view = torch.rand(2, 2, 64, 64, 64).round()
    direct(view, weak).square().mean().backward()
    assert len(direct.loads) == 7
    for load in direct.loads:
        assert load.shown.weight.grad.abs().max() > 0
        assert load.block.modulation.weight.grad.abs().max() > 0
    with torch.no_grad():
        apart = direct(view, weak) - direct(view, strong)
        aside = direct(view, weak) - direct(view, weak.flip(0))
    assert apart.abs().max() > 1e-2
    assert aside.abs().max() > 1e-2
