"""The page of a light map: radiance, the reference, the photographed ball."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear, tone_map
from metapp.appearance.geometry import Cosines
from metapp.appearance.latlong import luminance, resample_maps, solid_angles, texel_directions
from metapp.appearance.photograph import render_mirror_spheres
from metapp.appearance.reflection import microfacet_lobe
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.mirror import CLIPPED_VALUE, RADIANCE_FLOOR, shows_mirror
from metapp.apps.illumination.presenter import IlluminationPresenter
from metapp.apps.illumination.spheres import DIFFUSE_ALBEDO, DIFFUSE_SPECULAR, METAL_REFLECTANCE, SPHERE_ROUGHNESSES
from metapp.extensions.viewer.view import View, thumbnail
from metapp.learning.task import Batch, Params, Task

MAX_LIGHT_MAP_TEXELS = (512, 1024)  # texels of a map on a page
MAX_HALF_FLOAT = 65504.0  # the greatest of float16
ALBEDO_NODES = 32  # cosines that the albedos of lobes are known at


@torch.no_grad()
def make_illumination_view(
    presenter: IlluminationPresenter, theta: Params, task: Task, *, largest: tuple[int, int] = MAX_LIGHT_MAP_TEXELS
) -> View:
    """The map as `pictures` has it, to look around in, and spheres lit by it; of a photograph also the ball.

    Args:
        presenter: the application's.
        theta: the fit's parameters, without a task axis.
        task: what was fitted.
        largest: rows and columns that a larger map is reduced to.

    Raises:
        KeyError: a fit of a photograph without it.
    """
    app = presenter.app
    one = {key: value[None] for key, value in theta.items()}
    pixels = presenter.draw_map(theta, task).pixels
    unit = pixels.mean().clamp_min(1e-20)  # of PNGs of radiance
    light = pixels.permute(2, 0, 1) / unit
    maps = {"map": resample_maps(light, *largest) if light.shape[1] > largest[0] else light}
    if "map" in task.data:
        reference = task.data["map"].float() * task.data.get("scale", torch.ones(())) / unit
        maps["reference"] = resample_maps(reference, *maps["map"].shape[1:])
    scale = max(1.0, *(float(each.amax()) / MAX_HALF_FLOAT for each in maps.values()))
    arrays = {name: (each / scale).permute(1, 2, 0).half() for name, each in maps.items()}
    materials = {name: {"roughness": roughness} for name, roughness in SPHERE_ROUGHNESSES.items()}
    facts = {
        "scale": scale,
        "note": _note(pixels, maps["map"], task),
        "metal": METAL_REFLECTANCE,
        "albedo": DIFFUSE_ALBEDO,
        "specular": DIFFUSE_SPECULAR,
    }
    pictures = {}
    if app.protocol == "photo":
        data = {
            key: value[None] for key, value in {"photo": task.data["photos"][0], **app.prepare_mirror(task)}.items()
        }
        pictures = {"photo": data["photo"][0].permute(1, 2, 0) / 255, "ball": _ball(app, one, data).permute(1, 2, 0)}
    lobes = torch.stack([lobe_albedos(roughness) for roughness in SPHERE_ROUGHNESSES.values()]).half()
    shown = thumbnail(tone_map(maps["map"]).permute(1, 2, 0))
    return View("light", arrays, pictures, facts | materials, {"lobes": lobes}, shown)


def _note(pixels: Tensor, light: Tensor, task: Task) -> str:
    """Keep the arrays that `light` shows at another size: the map [H, W, 3], and the reference."""
    (rows, columns), size_shown = pixels.shape[:2], tuple(light.shape[1:])
    size = f"{size_shown[0]} x {size_shown[1]} texels"
    lines = [f"The map has {rows} x {columns} texels; this page shows {size}."] if size_shown != (rows, columns) else []
    if "map" in task.data and task.data["map"].shape[1:] != size_shown:
        lines += [f"The reference is averaged to the {size} of the fit."]
    return " ".join(lines)


def _ball(app: Illumination, theta: Params, data: Batch) -> Tensor:
    """Display values [3, S, S] of the ball of a fit's photograph, lit by the fit, above 1 if it would clip.

    Args:
        app: the application.
        theta: parameters of one task.
        data: of it, as of `App.prepare`, [1, ...].
    """
    size = data["photo"].shape[-1]
    if not shows_mirror(data):
        return app.render_ball(theta, app.radiance_maps(theta), size)[0].clamp(0, 1)
    photo, ball = data["photo"][0] / 255, render_mirror_spheres(app.answer(theta, data), size)[0]
    # no photograph says how bright its light was: exposed so that what it does not clip is as bright in the middle
    told = (photo.amax(0) < CLIPPED_VALUE) & (photo.amin(0) > RADIANCE_FLOOR) & (ball.amin(0) > 0)
    ratio = luminance(srgb_to_linear(photo))[told] / luminance(ball)[told]
    exposure = ratio.median() if told.any() else 1 / ball.amax().clamp_min(1e-9)
    return linear_to_srgb((ball * exposure).clamp(0, 1))


@functools.cache
def lobe_albedos(roughness: float, height: int = 256) -> Tensor:
    """The share of light that a GGX lobe reflects, [NODES], of viewers at cosines (i + 0.5) / NODES; spheres lose none.

    Args:
        roughness: its alpha is the square of that.
        height: of the grid of directions that it is summed over, enough for an alpha of 0.1.
    """
    cosines = (torch.arange(ALBEDO_NODES) + 0.5) / ALBEDO_NODES
    viewers = torch.stack([(1 - cosines * cosines).sqrt(), torch.zeros(ALBEDO_NODES), cosines], 1)
    lights = texel_directions(height, 2 * height).flatten(1)
    incident, outgoing, both = lights[2].expand(ALBEDO_NODES, -1), cosines[:, None], viewers @ lights
    length = (2 + 2 * both).clamp_min(1e-9).sqrt()
    at = Cosines(incident, outgoing, (incident + outgoing) / length, length / 2)
    lobe = microfacet_lobe(at, roughness * roughness, torch.ones_like).squeeze(-1)
    weights = solid_angles(height, 2 * height).expand(height, 2 * height).flatten()
    return (lobe * incident.clamp_min(0) * weights).sum(1)
