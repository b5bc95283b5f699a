"""The part of a view that relights photographs by a camera that stands still under many lamps (RTI).

The page mixes few planes by weights that it looks up for the direction of its lamp, see `scripts/relit.js`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, pad

from metapp.appearance.colour import stretch_to_unit_range
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos
from metapp.apps.svbrdf_nonstationary.rti.relit_planes import make_relit_planes
from metapp.extensions.viewer.view import View, channels_last, size_within

PLANE_COUNT = 12  # planes on a page: shaders may read 16 pictures
MAX_PLANE_SIDE_PX = 1024  # of planes on a page
MAX_PNG_SIDE_PX = 512  # of planes without loss; twelve of photographs of 534 px take 4.5 MB, as JPEG 1.0 MB
TABLE_SIDE = 64  # directions across; interpolation between them errs by 0.2/255, between 32 by 0.6/255
CHANNELS = 4  # of a texture


def add_relit_photos(view: View, lit_photos: LitPhotos) -> View:
    """Add photographs that a lamp relights to the view of a surface, beside its lit picture `relit`.

    Args:
        view: the view of the surface, of kind `surface`.
        lit_photos: the photographs.
    """
    relit = make_relit_planes(lit_photos, PLANE_COUNT)
    size = size_within(MAX_PLANE_SIDE_PX, lit_photos.photos)
    # display values of a relit photograph are linear in the planes, so that means over px may be taken first
    planes = {f"plane_{number}": adaptive_avg_pool2d(plane, size) for number, plane in enumerate(relit.planes)}
    stretched = {name: stretch_to_unit_range(plane) for name, plane in planes.items()}
    weights = relit.weights(table_directions().reshape(-1, 3)).reshape(TABLE_SIDE, TABLE_SIDE, -1)
    facts = {"ranges": [[low, high] for _, low, high in stretched.values()], "photos": len(lit_photos.photos)}
    return view._replace(
        pictures={**view.pictures, **{name: channels_last(plane) for name, (plane, _, _) in stretched.items()}},
        lossy=tuple(planes) if max(size) > MAX_PNG_SIDE_PX else (),
        arrays={**view.arrays, "weights": _stack_as_texels(weights).half()},
        facts={**view.facts, "relit": facts},
    )


def table_directions() -> Tensor:
    """Return the directions at which the page knows weights, unit vectors [TABLE_SIDE, TABLE_SIDE, 3], from y = -1 up.

    A direction lies at sqrt(1 - z) from the middle of the square [-1, 1]^2, as the handle of the page's lamp does; the
    horizon is the unit circle, and corners are the opposite of the middle.
    """
    across = torch.linspace(-1, 1, TABLE_SIDE)
    y, x = torch.meshgrid(across, across, indexing="ij")
    z = 1 - x.square() - y.square()
    stretch = (1 + z).clamp_min(0).sqrt()
    return torch.stack([x * stretch, y * stretch, z], -1)


def _stack_as_texels(weights: Tensor) -> Tensor:
    """Return weights [R, C, K] as texels of four, [ceil(K / 4) R, C, 4]: blocks of four planes below one another."""
    blocks = math.ceil(weights.shape[-1] / CHANNELS)
    padded = pad(weights, (0, blocks * CHANNELS - weights.shape[-1]))
    return torch.cat(padded.split(CHANNELS, -1))
