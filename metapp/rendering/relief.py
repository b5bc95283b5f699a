"""A displaced material on a table under distant lamps, as a camera that looks straight down sees it, by Mitsuba.

The relief is geometry: it casts shadows, and light that one part reflects on another comes back, once. So pictures hold
what no renderer of flat maps has. All lamps share the camera's rays and those of one reflection.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.surface import DIELECTRIC_F0
from metapp.appearance.svbrdf_maps import Maps
from metapp.rendering.jit import dr, mi
from metapp.rendering.types import Interaction, Scene
from metapp.rendering.variant import load_mitsuba

SEEN_HALF_SIDE = 0.85  # half side of the part that the camera sees: what lies around it casts shadows, too
CAMERA_HEIGHT = 3.0  # half sides of the relief; any height above it gives the same picture, since rays are parallel
SAMPLES_PER_PIXEL = 8


class LitRelief(NamedTuple):
    """A relief as a camera sees it under lamps.

    Attributes:
        radiance: linear radiance [N, 3, S, S]; a white matt plane that faces the lamp has 1.
        normal: unit normals [3, S, S] of what pixels show, on average.
    """

    radiance: Tensor
    normal: Tensor


def light_relief(maps: Maps, height: Tensor, lamps: Tensor, side: int, seed: int) -> LitRelief:
    """Render a relief under each of N distant lamps.

    Args:
        maps: maps [C, M, M] of the material, of which the normals do not count.
        height: its height [M, M] in half sides, which continues at the opposite edge.
        lamps: unit vectors towards the lamps, [N, 3]: x right, y up, z towards the camera.
        side: the side S of the pictures, in px; they show the middle of the relief, SEEN_HALF_SIDE.
        seed: seed of Mitsuba's random numbers.

    Raises:
        ValueError: Mitsuba cannot be imported; see :func:`load_mitsuba`.
    """
    load_mitsuba()
    scene = mi.load_dict({"type": "scene", "relief": _make_mesh(maps, height)})
    radiance, normals = np.zeros((len(lamps), 3, side * side), np.float32), np.zeros((3, side * side), np.float32)
    for sample in range(SAMPLES_PER_PIXEL):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed * SAMPLES_PER_PIXEL + sample, side * side)
        seen = _trace_from_above(scene, side, sampler)
        context, bsdf = mi.BSDFContext(), seen.bsdf()
        reflected, weight = bsdf.sample(context, seen, sampler.next_1d(), sampler.next_2d())
        lighting = scene.ray_intersect(seen.spawn_ray(seen.to_world(reflected.wo)))
        weight = dr.select(lighting.is_valid(), weight, 0)
        dr.eval(seen, lighting, weight)
        normals += np.array(seen.sh_frame.n).reshape(3, -1)
        for number, lamp in enumerate(lamps.tolist()):
            # opaque numbers, so that one compiled kernel serves all lamps
            direction = mi.Vector3f(*(dr.opaque(mi.Float, component) for component in lamp))
            direct, indirect = (_light_directly(scene, point, direction) for point in (seen, lighting))
            radiance[number] += np.array(dr.pi * (direct + weight * indirect)).reshape(3, -1)
    mean = torch.from_numpy(radiance / SAMPLES_PER_PIXEL).unflatten(-1, (side, side))
    normal = torch.nn.functional.normalize(torch.from_numpy(normals), dim=0)
    return LitRelief(mean, normal.unflatten(-1, (side, side)))


def _trace_from_above(scene: Scene, side: int, sampler: Any) -> Interaction:
    """Return what parallel rays from above meet first, one in each pixel of rows from the top, at random in it."""
    index, jitter = dr.arange(mi.UInt32, side * side), sampler.next_2d()
    x = ((mi.Float(index % side) + jitter.x) / side * 2 - 1) * SEEN_HALF_SIDE
    y = (1 - (mi.Float(index // side) + jitter.y) / side * 2) * SEEN_HALF_SIDE
    return scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, CAMERA_HEIGHT), mi.Vector3f(0, 0, -1)))


def _light_directly(scene: Scene, point: Interaction, direction: Any) -> Any:
    """Return the reflected radiance over the irradiance of a plane that faces a lamp; 0 in shadow, in 1/sr."""
    value = point.bsdf().eval(mi.BSDFContext(), point, point.to_local(direction))
    return dr.select(point.is_valid() & ~scene.ray_test(point.spawn_ray(direction)), value, 0)


def _make_mesh(maps: Maps, height: Tensor) -> Any:
    """Return a mesh of two triangles for each texel, with the principled BSDF that is closest to the maps."""
    side = height.shape[-1]
    # one more row and column, since a mesh does not continue at the opposite edge
    wrapped = np.pad(height.numpy(), ((0, 1), (0, 1)), mode="wrap")
    edge = np.arange(side + 1) / side
    u, v = np.meshgrid(edge, edge)
    positions = np.stack([2 * u - 1, 1 - 2 * v, wrapped], -1).reshape(-1, 3)
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    upper_left, lower_left = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    lower_right, upper_right = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    lower, upper = (upper_left, lower_left, lower_right), (upper_left, lower_right, upper_right)
    faces = np.concatenate([np.stack(lower, 1), np.stack(upper, 1)])
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": _describe_bsdf(maps)})
    mesh = mi.Mesh(
        "relief", len(positions), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=properties
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = positions.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = np.stack([u, v], -1).astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def _describe_bsdf(maps: Maps) -> dict[str, object]:
    """Describe a principled BSDF by base colour, metallic and roughness, which follow from the maps."""
    above = (maps.specular - DIELECTRIC_F0).clamp_min(0).mean(0, keepdim=True)
    metallic = above / (maps.diffuse.mean(0, keepdim=True) + above).clamp_min(1e-6)
    base = (maps.diffuse + maps.specular - DIELECTRIC_F0 * (1 - metallic)).clamp(0, 1)
    textures = {"base_color": base, "metallic": metallic, "roughness": maps.roughness}
    bitmaps = {
        name: {
            "type": "bitmap",
            "data": mi.TensorXf(np.ascontiguousarray(texture.permute(1, 2, 0).float().numpy())),
            "raw": True,
        }
        for name, texture in textures.items()
    }
    return {"type": "principled", **bitmaps}
