"""From one LDR photo of a sphere to an HDR environment map: ball_to_hdr.py PHOTO MAP.exr

The sphere fills PHOTO's central square, and has any diffuse or glossy material. The map is lat-long, linear Rec.709. A
photo does not tell how bright its light was, so the map has mean luminance 1.
"""

import sys
from pathlib import Path

import torch

import metapp
from metapp.storage.image_writers import write_exr

photo, map_file = map(Path, sys.argv[1:])
fit = metapp.fit("illumination", photo, observe="photo")
radiance = fit.maps["radiance"]  # [H, W, 3]
write_exr(torch.from_numpy(radiance), map_file)
height, width, _ = radiance.shape
row, column = divmod(int(radiance.sum(2).argmax()), width)
print(f"{fit.name}: {width} x {height} texels, fitted in {fit.seconds:.2f} s")
print(f"brightest texel: {float(radiance.max()):.1f} times the mean, {90 - 180 * (row + 0.5) / height:.0f} degrees up")
