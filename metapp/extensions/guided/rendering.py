"""Pictures of the scenes of transport, by `metapp_guided_path` and by `path` in the same time, whatever was fitted."""

from __future__ import annotations

from metapp.appearance.presentation import Picture, Rendered
from metapp.extensions.guided import equal_time
from metapp.extensions.guided.integrator import register_guided_path
from metapp.learning.task import Params, Task
from metapp.rendering.paths import path_space
from metapp.rendering.scenes.rules import scene_of

SPP = 64  # samples a pixel of the guided picture


def rendered(presentation: object, task: Task, theta: Params, side: int) -> Rendered:
    """The scene of a task by both, with next-event estimation.

    Args:
        presentation: of transport.
        task: holds the `scene`.
        theta: its fit, which path guiding does not read.
        side: the longer side of the pictures, px.

    Raises:
        ValueError: the task has no scene.
    """
    if "scene" not in task.data:
        raise ValueError(f"{task.name}: no scene, expected one to render; leave --render out.")
    tracer = path_space.Tracer(scene_of(task.data["scene"].cpu()))
    register_guided_path()
    equal_time.resize(tracer.scene, side)
    guided = equal_time.guided_picture(tracer.scene, SPP, tracer.depth)
    regular = equal_time.regular_picture(tracer.scene, guided.seconds, SPP, tracer.depth)
    spent = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in guided.spent.items())
    return Rendered(
        {"guided_path": Picture(guided.picture, "radiance"), "regular_nee": Picture(regular.picture, "radiance")},
        [
            f"guided_path: {guided.spp} samples a pixel in {guided.seconds:.2f} s of CPU ({spent}), without the fit",
            f"regular_nee: {regular.spp} samples a pixel in {regular.seconds:.2f} s of CPU",
        ],
    )
