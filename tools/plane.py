"""Draw a plane of a measured BRDF and of its fit, lit from beyond at a low angle: plane.py PICTURE FILE.bsdf.

The light stands in the picture's vertical middle line, so that phi_d changes its sign there: what a fit does not hold
for phi_d and -phi_d alike shows as an edge. Left the measurement, right the fit; one exposure for both.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

import metapp
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.geometry import directions_to_full_circle
from metapp.extensions.rgl.rgl import read_rgl
from metapp.storage.images import write_png

SIDE = 384  # px
CAMERA, LIGHT = (0.0, -1.6, 0.8), (0.0, 0.7, 0.45)  # the plane is z = 0, from -1 to 1
BRIGHTEST = 0.995  # the quantile of the measurement that is white


def places() -> tuple[Tensor, Tensor, Tensor]:
    """Directions to the light and to the camera [N, 3], and the light's irradiance [N, 1] but for its power."""
    rows, columns = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    at = (torch.stack([columns, SIDE - 1 - rows], 2).reshape(-1, 2) + 0.5) * (2 / SIDE) - 1
    at = torch.cat([at, torch.zeros(len(at), 1)], 1)
    to_light = torch.tensor(LIGHT) - at
    wi = normalize(to_light, dim=1)
    return wi, normalize(torch.tensor(CAMERA) - at, dim=1), wi[:, 2:] / to_light.square().sum(1, keepdim=True)


def main(picture: Path, file: Path) -> None:
    """Fit the file, write the picture."""
    wi, wo, irradiance = places()
    measured = read_rgl(file)(directions_to_full_circle(wi, wo)) * irradiance
    fit = torch.as_tensor(np.asarray(metapp.fit("brdf", file)(wi.numpy(), wo.numpy()))) * irradiance
    white = measured.amax(1).quantile(BRIGHTEST)
    both = torch.cat([each.reshape(SIDE, SIDE, 3) / white for each in (measured, fit)], 1)
    write_png(linear_to_srgb(both.clamp(0, 1)), {"encoding": "sRGB"}, picture)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
