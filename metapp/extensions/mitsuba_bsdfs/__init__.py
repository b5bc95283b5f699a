"""Fits as BSDFs of Mitsuba 3."""

from __future__ import annotations

from metapp.registry import Plugin, Registry

_HERE = "metapp.extensions.mitsuba_bsdfs"


def register(registry: Registry) -> None:
    """Add the plugins."""
    registry.plugins["neural_brdf"] = Plugin(f"{_HERE}.neural_brdf:register_neural_brdf")
    registry.plugins["neural_svbrdf"] = Plugin(f"{_HERE}.neural_svbrdf:register_maps_bsdf")
