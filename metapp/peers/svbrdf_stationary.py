"""The peer of networks of stationary svBRDFs: the nearest training material."""

from __future__ import annotations

from metapp.learning.app import App
from metapp.peers.exemplars import nearest_exemplar
from metapp.peers.peer import Peer


def peers(app: App) -> tuple[Peer, ...]:
    """Of flash photographs of stationary materials."""
    cannot = "be a material that is not in its set, nor be lit from elsewhere: it is a photograph"
    return (Peer("nearest", "the training photograph with the least error", cannot, nearest_exemplar),)


PEERS = peers
