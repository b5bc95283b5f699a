"""What phones that are held by hand do to photographs of a material, for data augmentation.

Relief moves in photographs that are registered on a plane (parallax), registration is off by parts of a texel, a room
adds its light, lenses darken the corners, and cameras develop what they see: a tone curve, and sharpening.
"""

from __future__ import annotations

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, pad

from metapp.appearance.flash import texel_positions
from metapp.appearance.height_fields import height_from_normal
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.multi_photo.parallax import read_displaced
from metapp.apps.svbrdf_nonstationary.variants import draws_per_material

# Largest strengths of each effect, which are drawn evenly for each material
MAX_REGISTRATION_ERROR = 0.008  # standard deviation of the displacement at the corners, in half sides: 1 texel of 256
MAX_AMBIENT_SHARE = 0.06  # light of the room over the light of the flash right below it
MAX_VIGNETTING = 0.14  # light that is lost a half side from the middle
MAX_TONE_CURVE, MAX_SHARPENING = 0.25, 0.7  # see :func:`develop_photos`
AMBIENT_COLOURS = (1.0, 0.85, 0.65), (0.8, 0.95, 1.0)  # of lamps and of daylight
SHARPENING_KERNEL = (0.25, 0.5, 0.25)  # along rows and columns: the blur that sharpening subtracts
MAX_RADIANCE = 1.5  # 1 is white
MAX_PARALLAX_HALF_SIDES = 0.06  # larger displacements would not be registered


def handle_photos(
    radiance: Tensor,
    maps: Maps,
    eyes: Tensor,
    rng: Generator,
    *,
    max_registration_error: float = MAX_REGISTRATION_ERROR,
    max_ambient_share: float = MAX_AMBIENT_SHARE,
    max_vignetting: float = MAX_VIGNETTING,
) -> Tensor:
    """Return photographs as a phone that is held by hand takes them, before they are developed.

    Displacements are relative to the first photograph, on which maps and the other photographs are registered.

    Args:
        radiance: linear photographs [T, N, 3, S, S], each shows a point of the surface at the same texel.
        maps: the maps of the materials, [T, C, S, S].
        eyes: positions of the camera, [T, N, 3], in half sides of the patch.
        rng: draws all random numbers.
        max_registration_error: largest standard deviation of the displacement at the corners, in half sides.
        max_ambient_share: largest light of the room, over the light of the flash right below it.
        max_vignetting: largest share of the light that is lost a half side from the middle.
    """
    uniform, normal = draws_per_material(len(radiance), rng)
    count, texels = radiance.shape[1], texel_positions(*radiance.shape[-2:], dtype=radiance.dtype, device=rng.device)
    tint = torch.stack([radiance.new_tensor(colour) for colour in AMBIENT_COLOURS])[(uniform() < 0.5).long()]
    ambient = max_ambient_share * uniform(1, 1, 1) * tint[:, :, None, None]
    lit = radiance + (ambient * (maps.diffuse * (1 - maps.specular) + maps.specular))[:, None]
    lit = lit * (1 - max_vignetting * uniform(1, 1, 1, 1) * texels.square().sum(0))
    lit = lit.clamp_max(MAX_RADIANCE)  # cubic interpolation beside a bright highlight would be black

    height = 2 / radiance.shape[-1] * height_from_normal(maps.normal, periodic=False)
    parallax = height[:, None] * (texels - eyes[:, :, :2, None, None]) / eyes[:, :, 2:, None, None]
    shift, linear, projective = normal(count, 2, 1, 1), normal(count, 2, 2), normal(count, 2)
    error = shift + torch.einsum("tnij,jhw->tnihw", linear, texels)
    error = (error + texels * torch.einsum("tni,ihw->tnhw", projective, texels)[:, :, None]) / 3
    error = max_registration_error * uniform(1, 1, 1, 1) * error
    displacement = parallax.clamp(-MAX_PARALLAX_HALF_SIDES, MAX_PARALLAX_HALF_SIDES) + error
    moved = read_displaced(lit.flatten(0, 1), (displacement[:, :1] - displacement).flatten(0, 1), "reflection")
    handled: Tensor = moved.clamp_min(0).unflatten(0, lit.shape[:2])
    return handled


def develop_photos(display: Tensor, rng: Generator) -> Tensor:
    """Return display values [T, N, 3, S, S] after a tone curve and sharpening, one of each for all photographs.

    The tone curve adds a multiple of v (1 - v) (2 v - 0.8) to a display value v: darker shadows, softer whites.
    Sharpening adds a multiple of the difference from blurred values.
    """
    uniform, _ = draws_per_material(len(display), rng)
    curve = MAX_TONE_CURVE * uniform(1, 1, 1, 1) * display * (1 - display) * (2 * display - 0.8)
    curved = (display + curve).flatten(0, 2)[:, None]
    kernel = display.new_tensor(SHARPENING_KERNEL)
    blurred = conv2d(pad(curved, (1, 1, 1, 1), "replicate"), (kernel[:, None] * kernel)[None, None])
    sharpness = MAX_SHARPENING * uniform(1, 1, 1, 1)
    curved, blurred = (values[:, 0].unflatten(0, display.shape[:3]) for values in (curved, blurred))
    developed: Tensor = (curved + sharpness * (curved - blurred)).clamp(0, 1)
    return developed
