"""Measures of the field, of pictures of fits beside the references: LPIPS, DISTS, PSNR and more."""

from __future__ import annotations

from metapp.registry import Measure, Registry

_HERE = "metapp.extensions.measures"
# PSNR compares pixel by pixel, which says nothing of pictures that are generated from noise
_ALIGNED = ("brdf", "svbrdf_nonstationary", "illumination", "transport")
_FLAT = ("texture", "svbrdf_stationary", "svbrdf_nonstationary")
_COLOUR = "CIE 2000 colour difference (D65), of which about 1 is just noticeable"
_DISTANCE = "distance of the distributions of features that no fit is compared by, over their deviation"
_ORDER = "of exemplars that repeat, the autocorrelation's peaks on their lattice, as high as the exemplar's at 1"


def register(registry: Registry) -> None:
    """Add the measures."""
    measures, colours, perceptual = registry.measures, f"{_HERE}.pixels:by", f"{_HERE}.perceptual:source"
    measures["CIE 2000, median"] = Measure(f"{_HERE}.pixels:median_difference", _COLOUR, ("brdf",), source=colours)
    measures["CIE 2000, 95 %"] = Measure(
        f"{_HERE}.pixels:high_difference", "the same, 95th percentile", ("brdf",), source=colours
    )
    measures["sliced Wasserstein"] = Measure(f"{_HERE}.textures:wasserstein", _DISTANCE, ("texture",))
    measures["order"] = Measure(f"{_HERE}.textures:order", _ORDER, ("texture",), more_is_better=True)
    measures["PSNR"] = Measure(f"{_HERE}.pixels:psnr", "dB, at most 100, more is better", _ALIGNED, more_is_better=True)
    measures["LPIPS"] = Measure(
        f"{_HERE}.perceptual:lpips",
        "Zhang et al. 2018, version 0.1, 0 for equal pictures",
        (*_FLAT, "illumination", "transport"),
        source=perceptual,
    )
    measures["DISTS"] = Measure(
        f"{_HERE}.perceptual:dists", "Ding et al. 2020, 0 for equal pictures", _FLAT, source=perceptual
    )
