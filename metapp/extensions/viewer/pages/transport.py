"""The page of a scene: reference, regular and guided paths in equal time, their errors; densities without a scene."""

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
from metapp.appearance.presenter import Presenter
from metapp.apps.transport import guide, guided_pictures
from metapp.apps.transport.app import Transport
from metapp.apps.transport.density_pictures import draw_flow_density, draw_sample_histograms
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.guided_pictures import REGULAR, SceneRenderer, renderer_of
from metapp.extensions.viewer.view import View, make_pictures_view, thumbnail
from metapp.learning.task import Params, Task
from metapp.rendering.paths import path_space
from metapp.runs.environment import torch_defaults
from metapp.storage import Document
from metapp.storage.tensor_cache import load_or_compute_tensors

WORST_REGION_ZOOM = 4  # times that the worst region is enlarged
GUIDED_LABEL = "guided by the fit"
MAX_HALF_FLOAT = 65504.0  # the greatest of float16

RenderSamples = Callable[[int, int], Tensor]  # of samples a pixel and a seed, a picture [3, size, size]


class Effort(NamedTuple):
    """What the pictures of a scene may cost.

    Attributes:
        side_px: side of the pictures, px.
        seconds: seconds of CPU for regular and for guided paths, each.
        reference_seconds: seconds of CPU for the reference.
    """

    side_px: int = 256
    seconds: float = 3.0
    reference_seconds: float = 10.0


DEFAULT_EFFORT = Effort()


class RenderingProgress(NamedTuple):
    """A picture [3, size, size] of so many spp at last; the seconds of CPU and the MAPE until then, at N times [N]."""

    picture: Tensor
    seconds: Tensor
    errors: Tensor
    spp: Tensor


def make_transport_view(presenter: Presenter[Transport], theta: Params, task: Task) -> View:
    """Pictures of the scene in equal time; densities if there is no scene."""
    app = presenter.app
    if "scene" in task.data:
        return make_scene_view(app.network, theta, task)
    shown = {"reference": draw_sample_histograms(task.data["samples"]), "fit": draw_flow_density(app.network, theta)}
    return make_pictures_view(shown)._replace(thumbnail=thumbnail(shown["fit"][:, : len(shown["fit"])]))


def make_scene_view(flow: Flow, theta: Params, task: Task, effort: Effort = DEFAULT_EFFORT) -> View:
    """Show the scene of a task; its pictures are kept in the cache folder, so that a page made again traces nothing."""
    made = _kept("fit", [task.data["scene"], *theta.values()], effort, lambda: _traced(flow, theta, task, effort))
    reference = made[REFERENCE_ERROR_NAME]
    unit = reference.mean().clamp_min(1e-20)  # pictures hold radiance of any unit then
    shots = {
        name: RenderingProgress(*(made[f"{name} {field}"] for field in RenderingProgress._fields))
        for name in (REGULAR, GUIDED_LABEL)
    }
    pictures = {REFERENCE_ERROR_NAME: reference, **{name: shot.picture for name, shot in shots.items()}}
    arrays = {
        name: (picture / unit).permute(1, 2, 0).clamp(0, MAX_HALF_FLOAT).half() for name, picture in pictures.items()
    }
    region = find_worst_region(shots[GUIDED_LABEL].picture, reference)
    told = {
        name: f"{shot.spp} spp, {shot.seconds[-1]:.2g} s, MAPE {shot.errors[-1]:.3g}" for name, shot in shots.items()
    }
    said, level = compare_at_equal_error(*shots.values())
    curves = {name: torch.stack([shot.seconds, shot.errors], 1).tolist() for name, shot in shots.items()}
    lines = [{"label": name, "points": points} for name, points in curves.items()]
    chart = {"x": "seconds of CPU", "y": "MAPE", "lines": lines, "level": {"label": "equal error", "y": level}}
    names = (REFERENCE_ERROR_NAME, *told)
    shown: list[Document] = [{"title": name, "name": name, "told": told.get(name, ""), "row": 0} for name in names]
    shown += [
        {"title": f"worst region x{WORST_REGION_ZOOM}, {name}", "name": name, "part": region, "row": 1}
        for name in names
    ]
    shown.append({"title": "error by time", "told": said, "chart": chart, "row": 2})
    shown += [{"title": f"error, {name}", "name": name, "error": True, "row": 2} for name in told]
    facts = {
        "pictures": shown,
        "compared": [REGULAR, GUIDED_LABEL],
        "reference": REFERENCE_ERROR_NAME,
        "region": region,
        "notes": [said, *_notes(made, "next_event" in task.data, effort)],
    }
    return View("pictures", arrays, {}, facts, thumbnail=thumbnail(tone_map(reference / unit).permute(1, 2, 0)))


def _kept(what: str, of: Sequence[Tensor], effort: Effort, make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """Tensors from the cache, for these inputs and this code."""
    settings = repr(tuple(effort)).encode()
    digest = hashlib.sha256(settings + b"".join(each.detach().cpu().numpy().tobytes() for each in of)).hexdigest()
    sources = [str(module.__file__) for module in (guide, guided_pictures, path_space)]
    return load_or_compute_tensors(f"view-transport-{what}-{digest[:20]}", [__file__, *sources], make)


def _traced(flow: Flow, theta: Params, task: Task, effort: Effort) -> dict[str, Tensor]:
    """The reference, with its own error, and the pictures of regular and guided paths as `RenderingProgress` has them."""
    studio = renderer_of(task, effort.side_px)
    with torch_defaults(single=True):  # the table is made of small tensors, for which threads only wait
        make = functools.partial(_reference_halves, studio, effort.reference_seconds)
        halves = _kept("reference", [task.data["scene"]], effort, lambda: {"halves": make()})["halves"]
        reference = halves.mean(0)
        begin = time.process_time()
        table = guide.make_guide_table(flow, theta)
        before, by = time.process_time() - begin, path_space.Guide(table.sample, table.density)
        side, seconds = effort.side_px, effort.seconds
        shots = {
            REGULAR: render_in_steps(
                lambda spp, seed: studio.render_regular(spp, seed).picture, reference, 0.0, seconds
            ),
            GUIDED_LABEL: render_in_steps(
                lambda spp, seed: path_space.render_paths(studio.tracer, spp, side, seed, by),
                reference,
                before,
                seconds,
            ),
        }
    # a half is as far from the mean of both as that is from the truth
    made = {REFERENCE_ERROR_NAME: reference, "own error": mape(halves[:1], reference[None])}
    for name, shot in shots.items():
        made |= {f"{name} {field}": value for field, value in shot._asdict().items()}
    return made


def _reference_halves(studio: SceneRenderer, seconds: float) -> Tensor:
    """Two pictures by Mitsuba's path, of other random numbers, [2, 3, size, size]."""
    studio.render_path(1)  # the first call compiles
    rate = studio.render_path(4).seconds / 4
    spp = max(1, round(seconds / 2 / max(rate, 1e-9)))
    return torch.stack([studio.render_path(spp, seed).picture for seed in (1, 2)])


def render_in_steps(
    shoot: RenderSamples, reference: Tensor, before: float, most_seconds: float = DEFAULT_EFFORT.seconds
) -> RenderingProgress:
    """Take a picture of as many samples as there is time for, measured each time that their number has doubled.

    Args:
        shoot: takes samples a pixel and a seed, which is another one for each part.
        reference: [3, size, size].
        before: seconds of CPU that something took before the first sample.
        most_seconds: seconds of CPU that all may take.
    """
    shoot(1, 0)  # the first call compiles
    total, count, spent, points, part = torch.zeros_like(reference), 0, before, list[tuple[float, float]](), 1
    while part > count // 8:  # a last part that is smaller would change nothing
        begin = time.process_time()
        total += part * shoot(part, len(points) + 1)
        seconds = time.process_time() - begin
        spent, count = spent + seconds, count + part
        points.append((spent, float(mape(total[None] / count, reference[None]))))
        part = min(count, int((most_seconds - spent) / max(seconds / part, 1e-9)))
    taken, errors = torch.tensor(points).unbind(1)
    return RenderingProgress(total / count, taken, errors, torch.tensor(count))


def compare_at_equal_error(regular: RenderingProgress, guided: RenderingProgress) -> tuple[str, float]:
    """A sentence on the time to an error that both reach, the greater of their last ones, and that error."""
    level = float(torch.maximum(regular.errors[-1], guided.errors[-1]))
    (first, exact), (second, also) = (_time_to(level, shot) for shot in (regular, guided))
    about = "" if exact and also else "about "
    share = (
        f"{about}{second / first:.2g} of the time" if second < first else f"{about}{second / first:.2g} times as long"
    )
    return f"To a MAPE of {level:.3g}: regular {first:.2g} s, {GUIDED_LABEL} {second:.2g} s, {share}.", level


def _time_to(level: float, shot: RenderingProgress) -> tuple[float, bool]:
    """Seconds to an error that a picture reaches, between measurements on a log scale; whether that is within them."""
    errors = shot.errors.cummin(0).values.clamp_min(1e-9).log().numpy()
    seconds = np.interp(-math.log(max(level, 1e-9)), -errors, shot.seconds.log().numpy())
    return math.exp(seconds), level < float(shot.errors[0])


def find_worst_region(picture: Tensor, reference: Tensor) -> list[int]:
    """The square, 1 / ZOOM of a side, in which errors, as of MAPE, are greatest in the mean: [x, y, width, height]."""
    side = max(1, reference.shape[1] // WORST_REGION_ZOOM)
    errors = ((picture - reference).abs() / reference.clamp_min(LEAST_SHARE_OF_MEAN * reference.mean())).mean(0)
    means = avg_pool2d(errors.clamp_max(4.0)[None], side, stride=1)[0]  # a firefly alone is no region
    row, column = divmod(int(means.argmax()), means.shape[1])
    return [column, row, side, side]


def _notes(made: dict[str, Tensor], next_event: bool, effort: Effort) -> list[str]:
    where = "from the second surface on" if next_event else "at no surface"
    return [
        f"{GUIDED_LABEL}: the fit guides three of four paths, with next-event estimation {where}. {REGULAR}: by the sampling "
        f"of materials. Both have about {effort.seconds:.0f} s of CPU, the guide's table counted; the fit and its "
        "samples are not: metapp evaluate --which image counts these.",
        f"The reference, by Mitsuba's path, has a MAPE of about {float(made['own error']):.2g} of its own, below which "
        "no error can be told. The worst region is that of the guided picture. All show the central square of the "
        "scene. spp: samples a pixel; s: seconds of CPU. Radiance is in units of the reference's mean.",
    ]
