"""White balance by the paper of the marker sheet: its colour becomes that of D65 (Bradford, by colour-science)."""

from __future__ import annotations

import numpy as np

from data_tools.readers.image_files import Pixels
from data_tools.readers.photos import linear_light
from metapp.appearance.colorimetry import colour_science
from metapp.extensions.capture.markers.sheet import Floats
from metapp.extensions.capture.markers.sighting import Sighting

CLIPPED = 0.95  # linear light from which a channel may be clipped: 250 of 255
DARK = 0.01  # below which noise and rounding colour it: 25 of 255
FEWEST = 0.25  # of the places that must lie between

_ASIDE_CM = (0.3, 0.4, 0.5)  # from the opening: beyond the line to cut along, before the markers
_ALONG = 64  # places along each side


def paper_colour(pixels: Pixels, sighting: Sighting) -> Floats:
    """The colour of a photograph's paper, between opening and markers: linear RGB [3], the greatest 1.

    Raises:
        ValueError: most of it is clipped, or too dark.
    """
    x, y = sighting.seen(_places_cm(sighting.opening)).round().astype(int).T
    seen = (x >= 0) & (x < sighting.width) & (y >= 0) & (y < sighting.height)
    part = pixels._replace(values=pixels.values[y[seen], x[seen]][None, :, :3])
    values = linear_light(part, slice(None))[0].astype(np.float64)
    clipped, dark = (values > CLIPPED).any(-1), (values < DARK).any(-1)
    good = values[~clipped & ~dark]
    if len(good) < FEWEST * len(values):
        found, remedy = ("clipped", "expose less") if clipped.sum() >= dark.sum() else ("too dark", "expose more")
        share = max(clipped.mean(), dark.mean())
        raise ValueError(
            f"{sighting.path}: {share:.0%} of the sheet's paper is {found} for --white, expected up to "
            f"{1 - FEWEST:.0%}; {remedy}, or leave out --white."
        )
    paper: Floats = np.median(good / good.sum(-1, keepdims=True), 0)
    paper /= paper.max()
    return paper


def _places_cm(opening: int) -> Floats:
    """Places [N, 2] on the sheet's paper, round the opening."""
    sides = []
    for aside in _ASIDE_CM:
        reach = opening / 2 + aside
        along, across = np.linspace(-reach, reach, _ALONG), np.full(_ALONG, reach)
        sides += [(along, across), (along, -across), (across, along), (-across, along)]
    return np.concatenate([np.stack(side, -1) for side in sides])


def adaptation(paper: Floats) -> Floats:
    """The matrix [3, 3] that adapts linear RGB to D65, multiplied with from the left: the paper becomes (1, 1, 1).

    Clip colours to the paper's before: neutral highlights that the camera clipped in one channel would be coloured.
    """
    colour = colour_science()
    space = colour.RGB_COLOURSPACES["sRGB"]
    to_xyz, to_rgb = space.matrix_RGB_to_XYZ, space.matrix_XYZ_to_RGB
    adapted = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        to_xyz @ paper, to_xyz @ np.ones(3), transform="Bradford"
    )
    matrix: Floats = to_rgb @ adapted @ to_xyz
    return matrix
