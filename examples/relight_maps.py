"""Relight the maps of a fitted svBRDF: relight_maps.py MAPS PICTURE.png

MAPS is the folder of a fit, such as `metapp meta svbrdf_nonstationary sign.jpg` writes, with diffuse.png, specular.png,
roughness.png and normal.png. The picture shows the maps under a light that moves from left to right.
"""

import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Tensor

from metapp.appearance.colour import radiance_to_display, srgb_to_linear
from metapp.appearance.flash import camera_position, render_maps, texel_positions
from metapp.appearance.svbrdf_maps import Maps


def read(file: Path) -> Tensor:
    """Read the values [1, C, H, W] of a PNG as they are stored, in [0, 1]."""
    pixels = np.atleast_3d(oiio.ImageBuf(str(file)).get_pixels(oiio.FLOAT))
    return torch.from_numpy(pixels).permute(2, 0, 1)[None]


folder, picture = map(Path, sys.argv[1:])
normal = 2 * read(folder / "normal.png") - 1
maps = Maps(
    diffuse=srgb_to_linear(read(folder / "diffuse.png")),
    specular=srgb_to_linear(read(folder / "specular.png")),
    roughness=read(folder / "roughness.png"),
    normal=normal / normal.norm(dim=1, keepdim=True),
)
positions, camera = texel_positions(*normal.shape[-2:]), camera_position()
lights = [torch.tensor([x, 0.5, 1.5]) for x in (-1.5, -0.5, 0.5, 1.5)]
pictures = torch.cat([radiance_to_display(render_maps(maps, positions, light, camera))[0] for light in lights], 2)
image = oiio.ImageBuf((255 * pictures.permute(1, 2, 0) + 0.5).byte().contiguous().numpy())
if not image.write(str(picture), "uint8"):
    sys.exit(f"{picture}: not written ({image.geterror()})")
print(f"{picture}: {len(lights)} pictures of {normal.shape[-1]} x {normal.shape[-2]} pixels, side by side")
