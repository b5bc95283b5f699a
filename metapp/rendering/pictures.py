"""Pictures of loaded scenes, by any integrator."""

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
    """A sensor, `side` px wide, that sees the central square of the picture of a scene's first, perspective one."""
    sensor = scene.sensors()[0]
    width, height = (int(n) for n in sensor.film().size())
    values = mi.traverse(sensor)
    across = math.tan(math.radians(float(np.array(values["x_fov"]).item())) / 2) * min(width, height) / width
    to_world = mi.ScalarTransform4f(np.array(values["to_world"].matrix).reshape(4, 4))
    fov = math.degrees(2 * math.atan(across))
    return mi.load_dict({"type": "perspective", "fov": fov, "to_world": to_world, "film": box_film(side, side)})


def render_scene(scene: Scene, integrator: Integrator, spp: int, seed: int, sensor: Sensor | int = 0) -> Tensor:
    """A picture by any integrator, linear RGB [rows, columns, 3]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of integrators that fall back to `path`
        picture = mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed)
    return torch.from_numpy(picture.numpy())[..., :3].clone()
