"""Peers: what a reader would use instead of a network, fitted to what fits see and judged by the same errors.

A module here with an application's name defines PEERS, a function of the application; `methods` holds the mathematics.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.learning.app import App
    from metapp.peers.peer import Peer


def peers_of(app: App) -> tuple[Peer, ...]:
    """The peers of an application under its protocol; none where nobody wrote any."""
    if app.name not in {module.name for module in pkgutil.iter_modules(__path__)}:
        return ()
    found: tuple[Peer, ...] = importlib.import_module(f"metapp.peers.{app.name}").PEERS(app)
    return found
