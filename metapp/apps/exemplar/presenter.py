"""Pictures and maps that are generated from noise: their sizes, and warnings about structure that they lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.lines import SEAM_STRENGTH_RATIO, compare_lines
from metapp.appearance.order import find_lattice, kept_order_share
from metapp.appearance.pictures import VisibleData
from metapp.appearance.presenter import Presenter
from metapp.appearance.uniform import collapsed_fit_warnings
from metapp.apps.exemplar.app import ExemplarApp, fixed_noise
from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params, Task, Tasks

MIN_ORDER_SHARE = 0.5  # share of an exemplar's order; quilting keeps 0.68 to 1.0
SHOWN_SEED = 1  # seed of the noise of pictures that are written and shown
FILE_SIDE_TIMES = 4  # times as high and wide as in training: what is written
LARGEST_PX = 4096  # px

Generating = TypeVar("Generating", bound=ExemplarApp)
Made = TypeVar("Made")


@dataclass(frozen=True)
class ExemplarPresenter(Presenter[Generating]):
    """What people look at of pictures or maps that a network generates from noise, like one exemplar.

    Attributes:
        least_lines: the share of the strength of an exemplar's lines below which its picture breaks them.
        shows_seams: whether lines that pictures add are seams; else they may be the light's.
    """

    least_lines: ClassVar[float] = 0.0
    shows_seams: ClassVar[bool] = True

    @override
    def size_refusal(self, height: int, width: int) -> str:
        step = 2 ** (self.app.network.levels - 1)
        fits = all(2 * step <= side <= LARGEST_PX and side % step == 0 for side in (height, width))
        return "" if fits else f"expects multiples of {step} from {2 * step} to {LARGEST_PX}"

    @property
    def picture_size(self) -> tuple[int, int]:
        """The height and width of files in px: the size asked for, else TILED times the exemplar's."""
        height, width = self.app.octaves.size()
        return self.size or (FILE_SIDE_TIMES * height, FILE_SIDE_TIMES * width)

    @override
    def visible(self, task: Task) -> VisibleData:
        return VisibleData(1, task.data["image"].nbytes, 1)  # all of the exemplar, in each step and by the encoder

    @torch.no_grad()
    def make_shown(
        self, theta: Params, make: Callable[[Params, Tensor], Made], size: tuple[int, int] | None = None
    ) -> Made:
        """Call a function of parameters and noise, such as `App.generate`, with a fit and the noise of its pictures.

        Args:
            theta: the fit, without a task axis.
            make: called with parameters [1, ...] and noise [1, 1, C, H, W].
            size: height and width in px; None for the exemplar's.
        """
        batched = {key: value[None] for key, value in theta.items()}
        rng, channels = Generator(theta["z"].device).manual_seed(SHOWN_SEED), self.app.network.noise
        return make(batched, draw_normal(rng, 1, 1, channels, *(size or self.app.octaves.size())))

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Return, for each task, at most one clause on what the picture of tables has lost.

        All of it, if the fit is black or the same everywhere; regular structure by its lattice; else lines that are
        broken, and seams. Only if networks read layouts.
        """
        app, statistics = self.app, self.app.statistics
        if not app.network.has_layout:
            return super().quality_warnings(theta, tasks)
        described = {key: value[tasks.rows] for key, value in tasks.data.items()}
        answer = app.generate(theta, fixed_noise(app, tasks.rows, 1, seed=SHOWN_SEED))
        exemplars = app.octaves.take_exemplar(described["image"].float() / 255)
        pictures = exemplars, statistics.look(answer, described)[:, 0]
        collapsed = [collapsed_fit_warnings(picture, exemplar) for exemplar, picture in zip(*pictures, strict=True)]
        exemplars, evenly_lit = (statistics.evenly_lit(photos, described) for photos in pictures)
        enlarged = self.pictures_for_lines(theta, evenly_lit)
        judged = zip(collapsed, exemplars, evenly_lit, enlarged, strict=True)
        return [clauses or self._find_lost(*compared) for clauses, *compared in judged]

    def _find_lost(self, exemplar: Tensor, picture: Tensor, enlarged: Tensor) -> list[str]:
        """Return the clause on structure of an exemplar that its picture, or one of another size, has lost; or none."""
        size = "x".join(map(str, self.picture_size))
        instead = f"`metapp baseline {self.app.name} INPUT --method quilting --size {size}` copies"
        if (share := kept_order_share(find_lattice(exemplar), picture)) < MIN_ORDER_SHARE:
            return [f"keeps {share:.2f} of the photo's regular structure ({instead} it)"]
        lines = compare_lines(exemplar, enlarged)
        if lines.fine_ratio < self.least_lines:
            figures = f"{lines.fine_ratio:.2f} as strong, expected {self.least_lines:g} or more"
            return [f"breaks lines of the photo such as joints, cracks or threads ({figures}, {instead} them)"]
        if self.shows_seams and lines.long_ratio > SEAM_STRENGTH_RATIO:
            return [
                f"shows seams, lines {lines.long_ratio:.1f} times as strong as the photo's ({instead} it, with fewer)"
            ]
        return []

    def pictures_for_lines(self, theta: Params, pictures: Tensor) -> Tensor:
        """Return the pictures [T, 3, h, w] whose lines are compared with the exemplars', here those of tables.

        Args:
            theta: the fits.
            pictures: those of tables, [T, 3, H, W], as if the light were the same everywhere.
        """
        return pictures
