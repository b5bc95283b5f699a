"""Pictures of the scenes of transport, by `metapp_guided_path` and by `path` in the same time, whatever was fitted.

They are the output `--render` of the application transport. Both integrators read the scene alone: no fit guides them.
"""

from __future__ import annotations

import time

import torch
from torch import Tensor

from metapp.appearance.pictures import Picture, ScenePictures
from metapp.extensions.guided.integrator import register_guided_path
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.rendering import pictures
from metapp.rendering.jit import mi
from metapp.rendering.paths import path_space
from metapp.rendering.scenes.stored_text import decode_scene
from metapp.rendering.types import Scene

GUIDED_PICTURE_SPP = 64  # samples a pixel of the guided picture
_WAVES_PER_PICTURE = 16  # a picture in a given time is rendered in about so many waves


def render_task(app: App, task: Task, theta: Params, side: int) -> ScenePictures:
    """Render the scene of a task by `metapp_guided_path` and by `path`, both with next-event estimation.

    Args:
        app: the application, transport.
        task: the task, which holds the `scene`.
        theta: the fit of the task, which path guiding does not read.
        side: the longer side of the pictures, in px.

    Raises:
        ValueError: the task has no scene.
    """
    if "scene" not in task.data:
        raise ValueError(f"{task.name}: no scene, expected one to render; leave --render out.")
    tracer = path_space.Tracer(decode_scene(task.data["scene"].cpu()))
    register_guided_path()
    resize_film(tracer.scene, side)
    guided_picture, seconds_by_part = render_guided_picture(tracer.scene, tracer.depth)
    seconds = sum(seconds_by_part.values())
    regular_picture, spp, regular_seconds = render_regular_picture(tracer.scene, seconds, tracer.depth)
    parts = ", ".join(f"{name} {part_seconds:.2f} s" for name, part_seconds in seconds_by_part.items())
    return ScenePictures(
        {"guided_path": Picture(guided_picture, "radiance"), "regular_nee": Picture(regular_picture, "radiance")},
        [
            f"guided_path: {GUIDED_PICTURE_SPP} samples a pixel in {seconds:.2f} s of CPU ({parts}), without the fit",
            f"regular_nee: {spp} samples a pixel in {regular_seconds:.2f} s of CPU",
        ],
    )


def resize_film(scene: Scene, side: int) -> None:
    """Give the film of a scene's first sensor another size, with so many pixels along its longer side."""
    values = mi.traverse(scene.sensors()[0])
    size = scene.sensors()[0].film().size()
    longer = max(int(size[0]), int(size[1]))
    values["film.size"] = values["film.crop_size"] = mi.ScalarVector2u([max(1, side * int(n) // longer) for n in size])
    values["film.crop_offset"] = mi.ScalarPoint2u(0)
    values.update()


def render_guided_picture(scene: Scene, depth: int) -> tuple[Tensor, dict[str, float]]:
    """Render the radiance [rows, columns, 3] by `metapp_guided_path`, and return the seconds of CPU of each part."""
    start = time.process_time()
    integrator = mi.load_dict({"type": "metapp_guided_path", "max_depth": depth})
    picture = pictures.render_scene(scene, integrator, GUIDED_PICTURE_SPP, 0)
    seconds_by_part, total = dict(integrator.spent), time.process_time() - start
    rest_name = "all else" if seconds_by_part else "regular samples"  # a picture without parts was rendered by `path`
    return picture, seconds_by_part | {rest_name: total - sum(seconds_by_part.values())}


def render_regular_picture(scene: Scene, seconds: float, depth: int) -> tuple[Tensor, int, float]:
    """Render the radiance by `path` in a given time, with one wave at least.

    Args:
        scene: the scene.
        seconds: the seconds of CPU that the picture may take, about.
        depth: the edges of the longest path.

    Returns:
        The radiance [rows, columns, 3], the samples a pixel, and the seconds of CPU.
    """
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    spp_per_wave = max(1, GUIDED_PICTURE_SPP // _WAVES_PER_PICTURE)
    start, longest_wave, radiance_sum, waves = time.process_time(), 0.0, torch.zeros(()), 0
    while not waves or time.process_time() - start + longest_wave / 2 <= seconds:
        wave_start = time.process_time()
        radiance_sum = radiance_sum + pictures.render_scene(scene, integrator, spp_per_wave, waves)
        waves, longest_wave = waves + 1, time.process_time() - wave_start
    return radiance_sum / waves, spp_per_wave * waves, time.process_time() - start
