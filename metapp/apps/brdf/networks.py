"""The networks of BRDFs, and which of them parameters belong to."""

from __future__ import annotations

from metapp.apps.brdf.featured import Featured
from metapp.apps.brdf.few import Few
from metapp.apps.brdf.nbrdf import NBRDF
from metapp.apps.brdf.network import BrdfNetwork
from metapp.learning.task import Params

NETWORKS: tuple[BrdfNetwork, ...] = (NBRDF, Featured(), Featured(anisotropic=True), Few())


def network_of(theta: Params) -> BrdfNetwork:
    """The network that parameters belong to, by their names.

    Raises:
        ValueError: they are of none.
    """
    for network in NETWORKS:
        if network.shapes.keys() == theta.keys():
            return network
    names = ", ".join(sorted(theta)) or "none"
    raise ValueError(f"parameters {names[:80]}, expected those of a BRDF fit.")
