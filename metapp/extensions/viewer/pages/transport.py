"""The view of a scene: reference, regular and guided paths in equal time, and their errors; densities without a scene.

Rendering takes seconds, so pictures are kept in the cache folder. The guide and the renderers are in
`metapp.apps.transport`; this module only spends the time and compares.
"""

from __future__ import annotations

import functools
import hashlib
import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.colour import tone_map
from metapp.appearance.metrics import LEAST_SHARE_OF_MEAN, mape
from metapp.appearance.pictures import REFERENCE_ERROR_NAME
from metapp.apps.transport import guide, scene_renderer
from metapp.apps.transport.density_pictures import draw_flow_density, draw_sample_histograms
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.scene_renderer import REGULAR, SceneRenderer, renderer_of
from metapp.extensions.viewer.view import MAX_HALF_FLOAT, View, crop_thumbnail, make_pictures_view
from metapp.learning.task import Params, Task
from metapp.rendering.paths import path_space
from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit
from metapp.storage import Document
from metapp.storage.tensor_cache import load_or_compute_tensors

WORST_REGION_ZOOM = 4  # factor by which the worst region is enlarged; its side is 1 / 4 of the picture's
GUIDED_LABEL = "guided by the fit"

# a function of samples a pixel and a seed that returns a picture [3, size, size]
RenderSamples = Callable[[int, int], Tensor]


class Effort(NamedTuple):
    """The time that the pictures of a scene may take, and their size.

    Attributes:
        side_px: side of the pictures.
        seconds: seconds of CPU for regular paths, and for guided paths.
        reference_seconds: seconds of CPU for the reference.
    """

    side_px: int = 256
    seconds: float = 3.0
    reference_seconds: float = 10.0


DEFAULT_EFFORT = Effort()


class RenderingProgress(NamedTuple):
    """A picture and how its error fell while it was rendered.

    Attributes:
        picture: the final picture, [3, size, size].
        seconds: seconds of CPU so far, at N points in time, [N].
        errors: MAPE of the picture so far, at these points, [N].
        spp: samples a pixel of the final picture.
    """

    picture: Tensor
    seconds: Tensor
    errors: Tensor
    spp: Tensor


def make_path_guide_page(fit: Fit) -> View:
    """Make the view of a scene: pictures by regular and by guided paths in equal time; densities without a scene."""
    network, task = fit.asset.app.decoder.network, fit.task
    if "scene" in task.data:
        return make_scene_view(network, fit.parameters, task)
    density = draw_flow_density(network, fit.parameters)
    pictures = {"reference": draw_sample_histograms(task.data["samples"]), "fit": density}
    return make_pictures_view(pictures)._replace(thumbnail=crop_thumbnail(density[:, : len(density)]))


def make_scene_view(flow: Flow, theta: Params, task: Task, effort: Effort = DEFAULT_EFFORT) -> View:
    """Make the view of the scene of a task, rendered by regular and by guided paths in equal time.

    Pictures are kept in the cache folder, so that a page that is made again traces nothing.

    Args:
        flow: the network of the application.
        theta: the parameters of the fit, without a task axis.
        task: the task, with its scene.
        effort: the time that pictures may take, and their size.
    """
    rendered = _load_or_render(
        "fit", [task.data["scene"], *theta.values()], effort, lambda: _render_all(flow, theta, task, effort)
    )
    reference = rendered[REFERENCE_ERROR_NAME]
    unit = reference.mean().clamp_min(1e-20)  # radiance of any unit fits into float16 in units of the mean
    progress_by_name = {
        name: RenderingProgress(*(rendered[f"{name} {field}"] for field in RenderingProgress._fields))
        for name in (REGULAR, GUIDED_LABEL)
    }
    pictures = {REFERENCE_ERROR_NAME: reference}
    pictures |= {name: progress.picture for name, progress in progress_by_name.items()}
    arrays = {
        name: (picture / unit).permute(1, 2, 0).clamp(0, MAX_HALF_FLOAT).half() for name, picture in pictures.items()
    }
    region = find_worst_region(progress_by_name[GUIDED_LABEL].picture, reference)
    captions = {
        name: f"{progress.spp} spp, {progress.seconds[-1]:.2g} s, MAPE {progress.errors[-1]:.3g}"
        for name, progress in progress_by_name.items()
    }
    comparison, level = compare_at_equal_error(*progress_by_name.values())
    curves = {
        name: torch.stack([progress.seconds, progress.errors], 1).tolist()
        for name, progress in progress_by_name.items()
    }
    lines = [{"label": name, "points": points} for name, points in curves.items()]
    chart = {"x": "seconds of CPU", "y": "MAPE", "lines": lines, "level": {"label": "equal error", "y": level}}
    names = (REFERENCE_ERROR_NAME, *captions)
    panels: list[Document] = [{"title": name, "name": name, "told": captions.get(name, ""), "row": 0} for name in names]
    panels += [
        {"title": f"worst region x{WORST_REGION_ZOOM}, {name}", "name": name, "part": region, "row": 1}
        for name in names
    ]
    panels.append({"title": "error by time", "told": comparison, "chart": chart, "row": 2})
    panels += [{"title": f"error, {name}", "name": name, "error": True, "row": 2} for name in captions]
    facts = {
        "pictures": panels,
        "compared": [REGULAR, GUIDED_LABEL],
        "reference": REFERENCE_ERROR_NAME,
        "region": region,
        "notes": [comparison, *_explain_comparison(rendered, "next_event" in task.data, effort)],
    }
    thumbnail = crop_thumbnail(tone_map(reference / unit).permute(1, 2, 0))
    return View("pictures", arrays, {}, facts, thumbnail=thumbnail)


def _load_or_render(
    what: str, inputs: Sequence[Tensor], effort: Effort, render: Callable[[], dict[str, Tensor]]
) -> dict[str, Tensor]:
    """Return rendered tensors from the cache, which are rendered if the inputs, the effort or the code are new.

    Args:
        what: the name of the tensors in the cache.
        inputs: the tensors that the result depends on.
        effort: the time that pictures may take, and their size.
        render: renders the tensors.
    """
    settings = repr(tuple(effort)).encode()
    content = b"".join(tensor.detach().cpu().numpy().tobytes() for tensor in inputs)
    digest = hashlib.sha256(settings + content).hexdigest()
    sources = [str(module.__file__) for module in (guide, scene_renderer, path_space)]
    return load_or_compute_tensors(f"view-transport-{what}-{digest[:20]}", [__file__, *sources], render)


def _render_all(flow: Flow, theta: Params, task: Task, effort: Effort) -> dict[str, Tensor]:
    """Render the reference, and pictures by regular and by guided paths.

    Returns:
        The reference under REFERENCE_ERROR_NAME and its own error under "own error"; for REGULAR and GUIDED_LABEL the
        fields of :class:`RenderingProgress`, as "<name> <field>".
    """
    renderer = renderer_of(task, effort.side_px)
    with torch_defaults(single=True):  # the table is made of small tensors, on which threads only wait for each other
        render_halves = functools.partial(_render_reference_halves, renderer, effort.reference_seconds)
        halves = _load_or_render("reference", [task.data["scene"]], effort, lambda: {"halves": render_halves()})[
            "halves"
        ]
        reference = halves.mean(0)
        begin = time.process_time()
        table = guide.make_guide_table(flow, theta)
        table_seconds, path_guide = time.process_time() - begin, path_space.Guide(table.sample, table.density)
        side, seconds = effort.side_px, effort.seconds
        progress_by_name = {
            REGULAR: render_in_steps(
                lambda spp, seed: renderer.render_regular(spp, seed).picture, reference, 0.0, seconds
            ),
            GUIDED_LABEL: render_in_steps(
                lambda spp, seed: path_space.render_paths(renderer.tracer, spp, side, seed, path_guide),
                reference,
                table_seconds,
                seconds,
            ),
        }
    # a half is as far from the mean of both halves as the mean is from the truth
    rendered = {REFERENCE_ERROR_NAME: reference, "own error": mape(halves[:1], reference[None])}
    for name, progress in progress_by_name.items():
        rendered |= {f"{name} {field}": value for field, value in progress._asdict().items()}
    return rendered


def _render_reference_halves(renderer: SceneRenderer, seconds: float) -> Tensor:
    """Render two pictures by Mitsuba's path tracer with different random numbers, [2, 3, size, size].

    Args:
        renderer: the renderer of the scene.
        seconds: seconds of CPU that both may take together.
    """
    renderer.render_path(1)  # the first call compiles
    seconds_per_spp = renderer.render_path(4).seconds / 4
    spp = max(1, round(seconds / 2 / max(seconds_per_spp, 1e-9)))
    return torch.stack([renderer.render_path(spp, seed).picture for seed in (1, 2)])


def render_in_steps(
    render: RenderSamples, reference: Tensor, seconds_before: float, most_seconds: float = DEFAULT_EFFORT.seconds
) -> RenderingProgress:
    """Render a picture of as many samples as there is time for, and measure it each time that their number has doubled.

    Args:
        render: renders a picture [3, size, size] of so many samples a pixel by a seed; each part has its own seed.
        reference: the reference, [3, size, size].
        seconds_before: seconds of CPU that were spent before the first sample.
        most_seconds: seconds of CPU that all parts may take, with the seconds before.
    """
    render(1, 0)  # the first call compiles
    total, count, spent, points, part = torch.zeros_like(reference), 0, seconds_before, list[tuple[float, float]](), 1
    while part > count // 8:  # a last part that is smaller would change nothing
        begin = time.process_time()
        total += part * render(part, len(points) + 1)
        seconds = time.process_time() - begin
        spent, count = spent + seconds, count + part
        points.append((spent, float(mape(total[None] / count, reference[None]))))
        part = min(count, int((most_seconds - spent) / max(seconds / part, 1e-9)))
    seconds_so_far, errors = torch.tensor(points).unbind(1)
    return RenderingProgress(total / count, seconds_so_far, errors, torch.tensor(count))


def compare_at_equal_error(regular: RenderingProgress, guided: RenderingProgress) -> tuple[str, float]:
    """Compare the seconds that regular and guided paths take to the same error.

    Returns:
        A sentence, and the error: the greater of both final errors, which both pictures reach.
    """
    level = float(torch.maximum(regular.errors[-1], guided.errors[-1]))
    (regular_seconds, regular_is_exact), (guided_seconds, guided_is_exact) = (
        _seconds_to_error(level, progress) for progress in (regular, guided)
    )
    about = "" if regular_is_exact and guided_is_exact else "about "
    ratio = guided_seconds / regular_seconds
    share = (
        f"{about}{ratio:.2g} of the time" if guided_seconds < regular_seconds else f"{about}{ratio:.2g} times as long"
    )
    sentence = (
        f"To a MAPE of {level:.3g}: regular {regular_seconds:.2g} s, {GUIDED_LABEL} {guided_seconds:.2g} s, {share}."
    )
    return sentence, level


def _seconds_to_error(level: float, progress: RenderingProgress) -> tuple[float, bool]:
    """Return the seconds to an error that a picture reaches, interpolated between measurements on a log scale.

    The second value says whether the error lies between measurements, and not before the first.
    """
    errors = progress.errors.cummin(0).values.clamp_min(1e-9).log().numpy()
    seconds = np.interp(-math.log(max(level, 1e-9)), -errors, progress.seconds.log().numpy())
    return math.exp(seconds), level < float(progress.errors[0])


def find_worst_region(picture: Tensor, reference: Tensor) -> list[int]:
    """Find the square region in which the mean relative error of a picture is greatest.

    Its side is the picture's over WORST_REGION_ZOOM. Errors are relative to the reference, as MAPE counts them.

    Args:
        picture: the picture, [3, size, size].
        reference: the reference, [3, size, size].

    Returns:
        The region, [x, y, width, height] in px.
    """
    side = max(1, reference.shape[1] // WORST_REGION_ZOOM)
    errors = ((picture - reference).abs() / reference.clamp_min(LEAST_SHARE_OF_MEAN * reference.mean())).mean(0)
    means = avg_pool2d(errors.clamp_max(4.0)[None], side, stride=1)[0]  # clamped, so that no firefly alone decides
    row, column = divmod(int(means.argmax()), means.shape[1])
    return [column, row, side, side]


def _explain_comparison(rendered: dict[str, Tensor], next_event: bool, effort: Effort) -> list[str]:
    """Write the notes of a page on how its pictures were rendered, and on how exact the reference is."""
    where = "from the second surface on" if next_event else "at no surface"
    own_error = float(rendered["own error"])
    return [
        f"{GUIDED_LABEL}: the fit guides three of four paths, with next-event estimation {where}. {REGULAR}: by the "
        f"sampling of materials. Both have about {effort.seconds:.0f} s of CPU, the guide's table counted; the fit and "
        "its samples are not: metapp evaluate --which image counts these.",
        f"The reference, by Mitsuba's path, has a MAPE of about {own_error:.2g} of its own, below which "
        "no error can be told. The worst region is that of the guided picture. All show the central square of the "
        "scene. spp: samples a pixel; s: seconds of CPU. Radiance is in units of the reference's mean.",
    ]
