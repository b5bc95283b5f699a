"""The protocol of the networks of BRDFs, and how parameters tell which one they belong to."""

from __future__ import annotations

import pytest
import torch
from torch import Generator

from metapp.apps.brdf.network import BrdfNetwork, network_of, shapes_of
from metapp.registry import registry

each_network = pytest.mark.parametrize("network", registry().loaded("networks", "brdf").values(), ids=repr)


@each_network
def test_parameters_tell_their_network(network: BrdfNetwork) -> None:
    theta = {key: value[0] for key, value in network.init(Generator().manual_seed(1), 2).items()}
    assert network_of(theta) is network
    assert {key: tuple(value.shape) for key, value in theta.items()} == shapes_of(network)
    assert set(network.task_parameters) <= set(theta)
    assert network.linear_parameter in ("", *theta)
    with pytest.raises(ValueError, match=r"^parameters .*, expected those of a BRDF fit"):
        network_of({key: value for key, value in theta.items() if key != "w1"})


@each_network
def test_phi_h_counts_where_a_network_says_so(network: BrdfNetwork) -> None:
    rng = Generator().manual_seed(2)
    theta = {
        key: value[0] + 0.1 * torch.randn(value.shape[1:], generator=rng) for key, value in network.init(rng, 1).items()
    }
    angles = torch.tensor([0.3, 0.5, 1.0, 0.0]).repeat(2, 3, 1)
    angles[1, :, 3] = 0.7
    values = network.evaluate(theta, angles)
    assert values.shape == (2, 3, 3)
    # one at a time: the rows of one product of matrices need not be the same to the bit
    first, turned = (network.evaluate(theta, each) for each in angles)
    assert torch.equal(first, turned) != network.anisotropic
    torch.testing.assert_close(network.evaluate(theta, angles[0, :, :3]), values[0])
    assert (network.folded(theta).turn is not None) == network.anisotropic
