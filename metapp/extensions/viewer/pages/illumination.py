"""The view of a light map: radiance to look around in, spheres lit by it, the reference, and the photographed ball.

The page's shader lights spheres by the map; it needs the albedos of lobes, which are tabulated here.
"""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear, tone_map
from metapp.appearance.geometry import Cosines
from metapp.appearance.latlong import luminance, resample_maps, solid_angles, texel_directions
from metapp.appearance.photograph import render_mirror_spheres
from metapp.appearance.reflection import microfacet_lobe
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_sight import SeenBall
from metapp.apps.illumination.mirror import CLIPPED_DISPLAY_VALUE, RADIANCE_FLOOR, shows_mirror
from metapp.apps.illumination.spheres import DIFFUSE_ALBEDO, DIFFUSE_SPECULAR, METAL_REFLECTANCE, SPHERE_ROUGHNESSES
from metapp.extensions.viewer.view import MAX_HALF_FLOAT, View, crop_thumbnail
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, add_task_axis
from metapp.runs.fit import Fit

MAX_LIGHT_MAP_TEXELS = (512, 1024)  # rows and columns of a map on a page
ALBEDO_NODES = 32  # cosines at which albedos of lobes are tabulated


@torch.no_grad()
def make_radiance_page(fit: Fit, *, largest: tuple[int, int] = MAX_LIGHT_MAP_TEXELS) -> View:
    """Make the view of a light map: to look around in, with spheres lit by it, and the ball of a fitted photograph.

    Args:
        fit: the fit, whose task has no data if they are not at hand.
        largest: rows and columns that a larger map is reduced to.

    Raises:
        KeyError: the fit is of a photograph, which the task lacks.
    """
    app: Any = fit.app
    task, pixels = fit.task, fit.asset.linear_maps()["radiance"]
    unit = pixels.mean().clamp_min(1e-20)  # maps are shown in units of the fit's mean radiance
    light = pixels.permute(2, 0, 1) / unit
    maps = {"map": resample_maps(light, *largest) if light.shape[1] > largest[0] else light}
    if "map" in task.data:
        reference = task.data["map"].float() * task.data.get("scale", torch.ones(())) / unit
        maps["reference"] = resample_maps(reference, *maps["map"].shape[1:])
    scale = max(1.0, *(float(light_map.amax()) / MAX_HALF_FLOAT for light_map in maps.values()))
    arrays = {name: (light_map / scale).permute(1, 2, 0).half() for name, light_map in maps.items()}
    materials = {name: {"roughness": roughness} for name, roughness in SPHERE_ROUGHNESSES.items()}
    facts = {
        "scale": scale,
        "note": _describe_sizes(pixels, maps["map"], task),
        "metal": METAL_REFLECTANCE,
        "albedo": DIFFUSE_ALBEDO,
        "specular": DIFFUSE_SPECULAR,
    }
    pictures = {}
    if (photo := app.sight.show_photo(task)) is not None:
        seen = app.sight.gather(stack_tasks(app, [task]))
        pictures = {
            "photo": photo.permute(1, 2, 0),
            "ball": _render_ball(app, add_task_axis(fit.parameters), seen).permute(1, 2, 0),
        }
    lobes = torch.stack([lobe_albedos(roughness) for roughness in SPHERE_ROUGHNESSES.values()]).half()
    thumbnail = crop_thumbnail(tone_map(maps["map"]).permute(1, 2, 0))
    return View("light", arrays, pictures, facts | materials, {"lobes": lobes}, thumbnail)


def _describe_sizes(pixels: Tensor, light: Tensor, task: Task) -> str:
    """Say which maps the page shows at another size than their own; "" for none.

    Args:
        pixels: the fitted map, [H, W, 3].
        light: the map on the page, [3, h, w].
        task: the task, whose reference counts as well.
    """
    (rows, columns), size_shown = pixels.shape[:2], tuple(light.shape[1:])
    size = f"{size_shown[0]} x {size_shown[1]} texels"
    lines = [f"The map has {rows} x {columns} texels; this page shows {size}."] if size_shown != (rows, columns) else []
    if "map" in task.data and task.data["map"].shape[1:] != size_shown:
        lines += [f"The reference is averaged to the {size} of the fit."]
    return " ".join(lines)


def _render_ball(app: Illumination, theta: Params, seen: SeenBall) -> Tensor:
    """Render the ball of a fitted photograph in the light of the fit, as display values [3, S, S] in [0, 1].

    Args:
        app: the application.
        theta: the parameters of one task, [1, ...].
        seen: the task's photograph, [1, ...].
    """
    size = seen.photo.shape[-1]
    if not shows_mirror(seen.mirror):
        return app.decoder(theta).photograph(size)[0].clamp(0, 1)
    photo, ball = seen.photo[0] / 255, render_mirror_spheres(app.prediction(theta, seen), size)[0]
    # a photograph does not say how bright its light was: the exposure makes the median of its measured pixels equal
    is_measured = (photo.amax(0) < CLIPPED_DISPLAY_VALUE) & (photo.amin(0) > RADIANCE_FLOOR) & (ball.amin(0) > 0)
    ratio = luminance(srgb_to_linear(photo))[is_measured] / luminance(ball)[is_measured]
    exposure = ratio.median() if is_measured.any() else 1 / ball.amax().clamp_min(1e-9)
    return linear_to_srgb((ball * exposure).clamp(0, 1))


@functools.cache
def lobe_albedos(roughness: float, height: int = 256) -> Tensor:
    """Compute the share of light that a GGX lobe reflects, for viewers at cosines (i + 0.5) / ALBEDO_NODES.

    The page divides by it, so that spheres lose no light.

    Args:
        roughness: the roughness, whose square is alpha.
        height: rows of the grid of directions that is summed over; 256 are enough for an alpha of 0.1.

    Returns:
        The shares, [ALBEDO_NODES].
    """
    cosines = (torch.arange(ALBEDO_NODES) + 0.5) / ALBEDO_NODES
    viewers = torch.stack([(1 - cosines * cosines).sqrt(), torch.zeros(ALBEDO_NODES), cosines], 1)
    lights = texel_directions(height, 2 * height).flatten(1)
    incident, outgoing, viewer_dot_light = lights[2].expand(ALBEDO_NODES, -1), cosines[:, None], viewers @ lights
    length = (2 + 2 * viewer_dot_light).clamp_min(1e-9).sqrt()
    cosines_of_pairs = Cosines(incident, outgoing, (incident + outgoing) / length, length / 2)
    lobe = microfacet_lobe(cosines_of_pairs, roughness * roughness, torch.ones_like).squeeze(-1)
    weights = solid_angles(height, 2 * height).expand(height, 2 * height).flatten()
    return (lobe * incident.clamp_min(0) * weights).sum(1)
