"""Pictures of loaded scenes, by any integrator.

Readers, tables and the viewer render references and baselines by it; light paths that a fit guides are rendered by
:mod:`metapp.rendering.paths.path_space`.
"""

from __future__ import annotations

import math
import warnings

import numpy as np
import torch
from torch import Tensor

from metapp.rendering.jit import mi
from metapp.rendering.scenes.rules import box_film
from metapp.rendering.types import Integrator, Scene, Sensor


def square_sensor(scene: Scene, side: int) -> Sensor:
    """Make a sensor that sees the central square of the picture of a scene's first sensor, a perspective one.

    Args:
        scene: the scene in Mitsuba.
        side: width and height of the new sensor's picture, px.
    """
    sensor = scene.sensors()[0]
    width, height = (int(count) for count in sensor.film().size())
    values = mi.traverse(sensor)
    half_width = math.tan(math.radians(float(np.array(values["x_fov"]).item())) / 2) * min(width, height) / width
    to_world = mi.ScalarTransform4f(np.array(values["to_world"].matrix).reshape(4, 4))
    fov = math.degrees(2 * math.atan(half_width))
    return mi.load_dict({"type": "perspective", "fov": fov, "to_world": to_world, "film": box_film(side, side)})


def render_scene(scene: Scene, integrator: Integrator, spp: int, seed: int, sensor: Sensor | int = 0) -> Tensor:
    """Render a picture by any integrator, linear RGB [rows, columns, 3].

    Args:
        scene: the scene in Mitsuba.
        integrator: the integrator in Mitsuba.
        spp: samples per pixel.
        seed: seed of all draws.
        sensor: a sensor in Mitsuba, or the index of one of the scene's.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # integrators that fall back to `path` warn of it
        picture = mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed)
    return torch.from_numpy(picture.numpy())[..., :3].clone()
