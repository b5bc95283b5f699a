"""The networks of BRDFs, and which of them parameters belong to."""

from __future__ import annotations

from metapp.apps.brdf.network import BrdfNetwork, shapes_of
from metapp.learning.task import Params
from metapp.registry import registry


def networks() -> list[BrdfNetwork]:
    """Instances of all networks, of any size."""
    return list(registry().loaded("networks", "brdf").values())


def network_of(theta: Params) -> BrdfNetwork:
    """The network that parameters belong to, by their names.

    Raises:
        ValueError: they are of none.
    """
    for network in networks():
        if shapes_of(network).keys() == theta.keys():
            return network
    names = ", ".join(sorted(theta)) or "none"
    raise ValueError(f"parameters {names[:80]}, expected those of a BRDF fit.")
