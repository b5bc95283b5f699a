"""Pictures of a scene by `metapp_guided_path`, and by `path` in the same time: seconds of CPU, everything counted.

Scenes are loaded; `spp` are samples a pixel, `depth` edges of the longest path, `seed` is of all draws.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.rendering.jit import mi
from metapp.rendering.pictures import rendered
from metapp.rendering.types import Scene

_WAVES = 16  # that a picture in a given time is made of, about


class TimedPicture(NamedTuple):
    """A picture.

    Attributes:
        picture: linear RGB radiance, [rows, columns, 3].
        spp: samples a pixel.
        spent: seconds of CPU by what they were spent on.
    """

    picture: Tensor
    spp: int
    spent: dict[str, float]

    @property
    def seconds(self) -> float:
        """All of them."""
        return sum(self.spent.values())


def resize(scene: Scene, side: int) -> None:
    """Give the film of a scene's first sensor another size: so many pixels along its longer side, all of it."""
    values = mi.traverse(scene.sensors()[0])
    size = scene.sensors()[0].film().size()
    longer = max(int(size[0]), int(size[1]))
    values["film.size"] = values["film.crop_size"] = mi.ScalarVector2u([max(1, side * int(n) // longer) for n in size])
    values["film.crop_offset"] = mi.ScalarPoint2u(0)
    values.update()


def guided_picture(scene: Scene, spp: int, depth: int, seed: int = 0) -> TimedPicture:
    """By `metapp_guided_path`, which must be registered."""
    begin = time.process_time()
    integrator = mi.load_dict({"type": "metapp_guided_path", "max_depth": depth})
    picture = rendered(scene, integrator, spp, seed)
    spent, total = dict(integrator.spent), time.process_time() - begin
    rest = "all else" if spent else "regular samples"  # where `path` rendered instead
    return TimedPicture(picture, spp, spent | {rest: total - sum(spent.values())})


def regular_picture(scene: Scene, seconds: float, spp: int, depth: int, seed: int = 0) -> TimedPicture:
    """By `path`, in as many waves as there are seconds of CPU for, one at least, of `spp` about in all."""
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    per_wave = max(1, spp // _WAVES)
    begin, longest, total, waves = time.process_time(), 0.0, torch.zeros(()), 0
    while not waves or time.process_time() - begin + longest / 2 <= seconds:
        start = time.process_time()
        total = total + rendered(scene, integrator, per_wave, seed * 2**16 + waves)
        waves, longest = waves + 1, time.process_time() - start
    return TimedPicture(total / waves, per_wave * waves, {"regular samples": time.process_time() - begin})
