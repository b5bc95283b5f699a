"""Pictures of the scenes of transport, by `metapp_guided_path` and by `path` in the same time, whatever was fitted."""

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
_WAVES = 16  # that a picture in a given time is made of, about


def render_task(app: App, task: Task, theta: Params, side: int) -> ScenePictures:
    """The scene of a task by both, with next-event estimation.

    Args:
        app: transport.
        task: holds the `scene`.
        theta: its fit, which path guiding does not read.
        side: the longer side of the pictures, px.

    Raises:
        ValueError: the task has no scene.
    """
    if "scene" not in task.data:
        raise ValueError(f"{task.name}: no scene, expected one to render; leave --render out.")
    tracer = path_space.Tracer(decode_scene(task.data["scene"].cpu()))
    register_guided_path()
    resize_film(tracer.scene, side)
    guided, spent = render_guided_picture(tracer.scene, tracer.depth)
    seconds = sum(spent.values())
    regular, spp, regular_seconds = render_regular_picture(tracer.scene, seconds, tracer.depth)
    parts = ", ".join(f"{name} {each:.2f} s" for name, each in spent.items())
    return ScenePictures(
        {"guided_path": Picture(guided, "radiance"), "regular_nee": Picture(regular, "radiance")},
        [
            f"guided_path: {GUIDED_PICTURE_SPP} samples a pixel in {seconds:.2f} s of CPU ({parts}), without the fit",
            f"regular_nee: {spp} samples a pixel in {regular_seconds:.2f} s of CPU",
        ],
    )


def resize_film(scene: Scene, side: int) -> None:
    """Give the film of a scene's first sensor another size: so many pixels along its longer side, all of it."""
    values = mi.traverse(scene.sensors()[0])
    size = scene.sensors()[0].film().size()
    longer = max(int(size[0]), int(size[1]))
    values["film.size"] = values["film.crop_size"] = mi.ScalarVector2u([max(1, side * int(n) // longer) for n in size])
    values["film.crop_offset"] = mi.ScalarPoint2u(0)
    values.update()


def render_guided_picture(scene: Scene, depth: int) -> tuple[Tensor, dict[str, float]]:
    """The radiance [rows, columns, 3] by `metapp_guided_path`, and seconds of CPU by task."""
    begin = time.process_time()
    integrator = mi.load_dict({"type": "metapp_guided_path", "max_depth": depth})
    picture = pictures.render_scene(scene, integrator, GUIDED_PICTURE_SPP, 0)
    spent, total = dict(integrator.spent), time.process_time() - begin
    rest = "all else" if spent else "regular samples"  # where `path` rendered instead
    return picture, spent | {rest: total - sum(spent.values())}


def render_regular_picture(scene: Scene, seconds: float, depth: int) -> tuple[Tensor, int, float]:
    """The radiance by `path` in about so many seconds of CPU, in one wave at least; samples a pixel, and seconds."""
    integrator = mi.load_dict({"type": "path", "max_depth": depth})
    per_wave = max(1, GUIDED_PICTURE_SPP // _WAVES)
    begin, longest, total, waves = time.process_time(), 0.0, torch.zeros(()), 0
    while not waves or time.process_time() - begin + longest / 2 <= seconds:
        start = time.process_time()
        total = total + pictures.render_scene(scene, integrator, per_wave, waves)
        waves, longest = waves + 1, time.process_time() - start
    return total / waves, per_wave * waves, time.process_time() - begin
