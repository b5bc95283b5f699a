"""General of flash photos over frozen features of VGG-16, and real materials to train it on."""

from __future__ import annotations

from metapp.door import Recipe

_HERE = "metapp.extensions.pretrained"
OFFERS = (Recipe("svbrdf_nonstationary", "pretrained", f"{_HERE}.recipe:PRETRAINED", "photo"),)
