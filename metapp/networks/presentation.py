"""Presentations of applications that share their networks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar, TypeVar

import torch
from torch import Generator, Tensor

from metapp.appearance.presentation import Fitted, Presentation, Visible
from metapp.learning.app import stack
from metapp.learning.draws import normal
from metapp.learning.task import Params, Task
from metapp.networks.coded import CodedApp
from metapp.networks.exemplar import SHOWN, ExemplarApp

TILED = 4  # times as high and wide as in training: what is written
LARGEST = 4096  # px

T = TypeVar("T")
AnyCoded = TypeVar("AnyCoded", bound=CodedApp)
AnyExemplar = TypeVar("AnyExemplar", bound=ExemplarApp)


class CodedPresentation(Presentation[AnyCoded]):
    """Of applications whose pictures are among what their errors measure.

    Attributes:
        of_pictures: which `errors` are of pictures, and what tables of these call them.
    """

    of_pictures: ClassVar[dict[str, str]]

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """Those errors that are of pictures, and what extensions measure; of a task without reference none."""
        stacked, measured = stack(self.app, [task]), super().image_errors(fits, task)
        for name, fit in fits.items():
            if errors := self.app.errors({key: value[None] for key, value in fit.theta.items()}, stacked):
                errors["error"] = self.app.scale * errors["error"]
                own = {title: float(errors[key]) for key, title in self.of_pictures.items()}
                measured[name] = own | measured.get(name, {})
        return measured


class ExemplarPresentation(Presentation[AnyExemplar]):
    """Of applications that generate pictures from noise, of any size."""

    def visible(self, task: Task) -> Visible:
        """The exemplar, all of it in each step."""
        return Visible(1, task.data["image"].nbytes, 1)

    def refusal(self, height: int, width: int) -> str:
        step = 2 ** (self.app.setup.network.levels - 1)
        fits = all(2 * step <= side <= LARGEST and side % step == 0 for side in (height, width))
        return "" if fits else f"expects multiples of {step} from {2 * step} to {LARGEST}"

    @torch.no_grad()
    def generated(self, theta: Params, make: Callable[[Params, Tensor], T], size: tuple[int, int]) -> T:
        """Call `make` with theta [1, ...] and noise [1, 1, ...] of a size, height and width in px."""
        one = {key: value[None] for key, value in theta.items()}
        rng, channels = Generator(theta["z"].device).manual_seed(SHOWN), self.app.setup.network.noise
        return make(one, normal(rng, 1, 1, channels, *size))

    def whole(self) -> tuple[int, int]:
        """The size of `files`: the one asked for, else TILED times the exemplar's."""
        return self.size or (TILED * self.app.setup.height, TILED * self.app.setup.width)

    def once(self) -> tuple[int, int]:
        """The exemplar's size."""
        return self.app.setup.height, self.app.setup.width
