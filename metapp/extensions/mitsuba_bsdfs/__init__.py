"""Fits as BSDFs of Mitsuba 3."""

from __future__ import annotations

from metapp.door import Plugin

_HERE = "metapp.extensions.mitsuba_bsdfs"
OFFERS = (
    Plugin("neural_brdf", f"{_HERE}.neural_brdf:register_neural_brdf"),
    Plugin("neural_svbrdf", f"{_HERE}.neural_svbrdf:register_maps_bsdf"),
)
