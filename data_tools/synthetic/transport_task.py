"""Tasks of light transport: samples of the light paths of a scene.

The embedded set, the command `metapp data cornell` and readers of scene files make their tasks here. Where a scene
comes from is not known; how its paths are traced is decided in `metapp.rendering.paths`.
"""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.task import Task
from metapp.rendering.paths.path_space import Tracer
from metapp.rendering.paths.resampling import draw_path_samples
from metapp.rendering.scenes.rules import SceneDict
from metapp.rendering.scenes.stored_text import encode_scene

SAMPLES, HELD_OUT = 32_768, 8_192  # samples of a scene that a fit sees, and for tests alone
UNITS = {
    "samples": "primary sample space, in [0, 1) [N, 4]: film (x right, y down), then two numbers for the direction at "
    "the first surface that scatters; in proportion to the luminance carried",
    "held_out": "as samples; for tests alone",
    "image": "linear RGB radiance [3, 32, 32], rows from the top; noisy",
    "scene": "Mitsuba 3 scene as JSON text, UTF-8, blanks at its end",
    "next_event": "1 where paths had next-event estimation and samples were resampled and moved; else missing",
}
BESIDE = ("scene", ".json")  # a tensor that is written as a file beside each shard, too, and the end of the file's name


def make_transport_task(
    name: str,
    scene: SceneDict,
    seed: int,
    *,
    samples: int = SAMPLES,
    held_out: int = HELD_OUT,
    batch_paths: int | None = None,
) -> Task:
    """Trace light paths of a scene, and return their samples and the rendered image as a task.

    Args:
        name: name of the task.
        scene: scene dictionary, as `metapp.rendering.scenes.loading.load_scene` takes it.
        seed: seed of all draws.
        samples: N, number of samples that a fit sees.
        held_out: M, number of samples for tests alone.
        batch_paths: paths that are traced at a time; None for as many as :class:`Tracer` traces.

    Returns:
        `samples` [N, 4], `held_out` [M, 4] and `image` [3, 32, 32], float32, and `scene`, uint8 [L]; where paths had
        next-event estimation also `next_event`, uint8 [1].

    Raises:
        ValueError: `load_scene` or `draw_path_samples` refuses the scene.
    """
    rng, tracer = Generator().manual_seed(seed), Tracer(scene, batch_paths=batch_paths)
    points, image = draw_path_samples(tracer, samples + held_out, rng)
    data = {"samples": points[:samples], "held_out": points[samples:], "image": image, "scene": encode_scene(scene)}
    if tracer.next_event:
        data["next_event"] = torch.ones(1, dtype=torch.uint8)
    return Task(name, data)
