"""The sight of photographs by a camera that stands still under many lamps, and the loss of maps by them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.distant_lamps import render_lit
from metapp.appearance.doubts import UNRELATED_LAMPS
from metapp.appearance.highlight import F0_BOUND_CLAUSE, clipped_highlight_warnings
from metapp.appearance.svbrdf_maps import Maps, mean_tilt_degrees
from metapp.apps.svbrdf_nonstationary.map_judge import TrueMaps
from metapp.apps.svbrdf_nonstationary.maps import decode_photo
from metapp.apps.svbrdf_nonstationary.material_sight import MaterialSight
from metapp.apps.svbrdf_nonstationary.rti.curve_network import CurveNetwork, LitTexels, TexelAnswer
from metapp.apps.svbrdf_nonstationary.rti.light_curves import curve_weights
from metapp.apps.svbrdf_nonstationary.rti.light_process import left_out_db, left_out_gain_db
from metapp.apps.svbrdf_nonstationary.rti.lit_augmentation import draw_lit_texels
from metapp.apps.svbrdf_nonstationary.rti.lit_photos import LitPhotos
from metapp.learning.components import VisibleData
from metapp.learning.rounding import round_absolute
from metapp.learning.task import Params, Task, Tasks

LOG_FLOOR = 0.02  # of white: the log of radiance is flat below, where noise and interreflections are
SMOOTHING = 0.05  # log radiance: |differences| of photographs and renderings are rounded off below


@dataclass(frozen=True)
class LitSight(MaterialSight[TexelAnswer, LitTexels]):
    """The sight of photographs under lamps, of which a step sees random texels under all lamps."""

    observes = "photo"
    seen_type = LitTexels

    @override
    def prepare(self, task: Task, decoder: CurveNetwork) -> LitTexels:
        """Prepare all texels. Raises ValueError if the task has no photographs under lamps."""
        if "lit" not in task.data or "lamps" not in task.data:
            raise ValueError(f"{task.name}: no photos under lamps, expected `lit` and `lamps`; take another recipe.")
        colours, lamps = task.data["lit"].flatten(2), task.data["lamps"].float()
        numbers = torch.arange(colours.shape[-1])
        return LitTexels(decode_photo(task.data["photo"]), colours, lamps, curve_weights(lamps), numbers)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> LitTexels:
        """Draw `count` texels of each task, the same ones under all lamps; all texels if there are not more."""
        data, rows = tasks.data, tasks.rows
        total = data["numbers"].shape[-1]
        if count >= total:
            return self.gather(tasks)
        chosen = torch.randint(total, (count,), generator=rng, device=rng.device)
        rest = {name: data[name][rows] for name in ("photo", "lamps", "weights")}
        # texels are selected first: all values of all photographs may be gigabytes
        return LitTexels(colours=data["colours"][..., chosen][rows], numbers=data["numbers"][..., chosen][rows], **rest)

    @override
    def read_cameras(self, task: Task) -> Tensor:
        return task.data["lamps"]

    @override
    def photos(self, task: Task) -> Tensor:
        return task.data["lit"]

    @override
    def lit_photos(self, task: Task) -> LitPhotos:
        return LitPhotos(task.data["lit"], task.data["lamps"].float())

    @override
    def fill(self, answer: TexelAnswer, photo: Tensor) -> Maps:
        """Return the maps [T, C, H, W]; none are filled."""
        return Maps(*(part.reshape(*part.shape[:2], *photo.shape[-2:]) for part in answer.maps))

    @override
    def loss(self, answer: TexelAnswer, seen: LitTexels, loss_parameters: Params) -> Tensor:
        """Return the mean rounded |difference| of log photographs and log renderings of each task, [T].

        Each photograph has a gain of its own, the median difference. Shadows and reflections of other parts, which
        renderings of texels lack, are outliers, of which absolute differences feel little.
        """
        smoothing = loss_parameters["smoothing"].exp() if loss_parameters else answer.maps.normal.new_tensor(SMOOTHING)
        radiance = render_lit(answer.maps, seen.lamps)
        logs = (srgb_to_linear(seen.colours.float() / 255) + LOG_FLOOR).log()
        residual = logs - (radiance.clamp(0, 1) + LOG_FLOOR).log()
        gain = residual.detach().flatten(2).median(-1).values[..., None, None]
        # texels that are black in all photographs, such as those of a ball, show nothing
        is_shown = (seen.colours.amax((1, 2), keepdim=True) > 0).float()
        return (round_absolute(residual - gain, smoothing) * is_shown).mean((1, 2, 3))

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return `smoothing` [steps], the log of SMOOTHING."""
        return {"smoothing": torch.full((steps,), math.log(SMOOTHING))}

    @override
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> tuple[LitTexels, TrueMaps]:
        return draw_lit_texels(tasks, rng)

    @override
    def fit_remarks(self, answer: TexelAnswer, task: Task) -> dict[str, object]:
        """Return the mean tilt of normals, the number of photographs, and how well others predict each left-out one."""
        lit_photos = self.lit_photos(task)
        return {
            "mean_tilt_degrees": mean_tilt_degrees(answer.maps.normal),
            "left_out_db": float(left_out_db(lit_photos.process, lit_photos.photos, lit_photos.lamps).mean()),
            "counts": {"photos": len(lit_photos.photos)},
        }

    @override
    def quality_warnings(self, answer: TexelAnswer, seen: LitTexels) -> list[list[str]]:
        """Return for each task clauses on highlights that clip, and on directions that do not go with photographs."""
        return [
            [
                *clipped_highlight_warnings(colours.amin(0)[..., None] / 255, F0_BOUND_CLAUSE, "all photos"),
                *UNRELATED_LAMPS.about(left_out_gain_db(colours, lamps)),
            ]
            for colours, lamps in zip(seen.colours, seen.lamps, strict=True)
        ]

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, all photographs, which General reads, too."""
        count = len(task.data["lit"])
        return VisibleData(count, task.data["lit"][0].nbytes, count)
