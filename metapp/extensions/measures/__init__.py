"""Measures of the field, of pictures of fits beside the references: LPIPS, DISTS, PSNR and more."""

from __future__ import annotations

from metapp.door import PictureMeasure

_HERE = "metapp.extensions.measures"
# PSNR compares pixel by pixel, which says nothing of pictures that are generated from noise
_ALIGNED = ("brdf", "svbrdf_nonstationary", "illumination", "transport")
_FLAT = ("texture", "svbrdf_stationary", "svbrdf_nonstationary")
_COLOUR = "CIE 2000 colour difference (D65), of which about 1 is just noticeable"
_DISTANCE = "distance of the distributions of features that no fit is compared by, over their deviation"
_ORDER = "of exemplars that repeat, the autocorrelation's peaks on their lattice, as high as the exemplar's at 1"
OFFERS = (
    PictureMeasure("CIE 2000, median", ("brdf",), f"{_HERE}.pixels:median_difference", _COLOUR, f"{_HERE}.pixels:by"),
    PictureMeasure(
        "CIE 2000, 95 %",
        ("brdf",),
        f"{_HERE}.pixels:high_difference",
        "the same, 95th percentile",
        f"{_HERE}.pixels:by",
    ),
    PictureMeasure("sliced Wasserstein", ("texture",), f"{_HERE}.textures:wasserstein", _DISTANCE),
    PictureMeasure("order", ("texture",), f"{_HERE}.textures:order", _ORDER, more_is_better=True),
    PictureMeasure("PSNR", _ALIGNED, f"{_HERE}.pixels:psnr", "dB, at most 100, more is better", more_is_better=True),
    PictureMeasure(
        "LPIPS",
        (*_FLAT, "illumination", "transport"),
        f"{_HERE}.perceptual:lpips",
        "Zhang et al. 2018, version 0.1, 0 for equal pictures",
        f"{_HERE}.perceptual:source",
    ),
    PictureMeasure(
        "DISTS",
        _FLAT,
        f"{_HERE}.perceptual:dists",
        "Ding et al. 2020, 0 for equal pictures",
        f"{_HERE}.perceptual:source",
    ),
)
