"""The presentation of an application: its title, the meaning of its errors, pictures and files of its fits."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Generic, Literal, NamedTuple, TypeVar, get_args

from torch import Tensor

from metapp.appearance.surface import Surface, linear_maps
from metapp.door import PictureMeasure, load, offers
from metapp.learning.app import App
from metapp.learning.task import Params, Task

Kind = Literal["srgb", "data", "height", "radiance"]
KINDS: tuple[Kind, ...] = get_args(Kind)
REFERENCE = "reference"  # among measures of pictures: what the references are off by themselves


class Picture(NamedTuple):
    """A file that a fit makes.

    Attributes:
        pixels: [H, W, 1 or 3].
        kind: "srgb": colours, display values in [0, 1], kept as PNG. "data": linear and no colours, such as normals, in
            [0, 1], kept as PNG. "height": heights in texels, of any range, kept as PNG, stretched to [0, 1], with both
            ends as texts of the file. "radiance": linear RGB of any range, kept as EXR, and tone-mapped beside it.
    """

    pixels: Tensor
    kind: Kind


class Rendered(NamedTuple):
    """Pictures of a task's scene.

    Attributes:
        files: by the file's name without its ending.
        lines: what to say of them.
    """

    files: dict[str, Picture]
    lines: list[str]


class Compared(NamedTuple):
    """Pictures of a fit and what they should be: display values [B, 3, H, W] in [0, 1].

    The bool `mask` [H, W] says which pixels count; None: all.
    """

    pictures: Tensor
    references: Tensor
    mask: Tensor | None = None

    def measures(self, app: str) -> dict[str, float]:
        """What extensions measure of an application's pictures, by name; what lacks something is left out."""
        values = {offer.name: load(offer.measure)(self) for offer in picture_measures(app)[0]}
        return {name: value for name, value in values.items() if math.isfinite(value)}


def picture_measures(app: str) -> tuple[dict[PictureMeasure, str], list[str]]:
    """The measures of an application's pictures with notes on them, and a line for each that lacks something."""
    notes, missing = {}, []
    for offer in (offer for offer in offers(PictureMeasure) if app in offer.apps):
        try:
            notes[offer] = ", ".join([offer.note, *([load(offer.source)()] if offer.source else [])])
        except ValueError as error:
            missing.append(f"{offer.name}: {error}")
    return notes, missing


class Visible(NamedTuple):
    """The part of a task that a fit may see.

    Attributes:
        samples: how many it draws from; 1 where each step sees all there is.
        size: bytes of one, as data sets keep it.
        encoder: samples that General's encoder reads of these.
    """

    samples: int
    size: int
    encoder: int


class Fitted(NamedTuple):
    """A fit of one task: parameters without task axis, and the seconds of inference that it took."""

    theta: Params
    seconds: float


AnyApp = TypeVar("AnyApp", bound=App)
AnyMade = TypeVar("AnyMade")


class Presentation(ABC, Generic[AnyApp]):
    """The names, pictures and files of an application's fits.

    Attributes:
        app: the application, at a recipe's setup and under a protocol.
        title: as in tables.
        measure: what the error is, in one line.
        logarithmic: True where the error is a logarithm, of any sign: of two, the difference counts, not the ratio.
        image_measure: what `image_errors` are of, in one line; "" where there are none.
        measures: further errors whose means tables state: what they are, by their names in records.
        size: height and width of `files`, px; None for the application's own choice.
    """

    title: str
    measure: str
    logarithmic: bool = False
    image_measure: str = ""
    measures: Mapping[str, str] = MappingProxyType({})

    def __init__(self, app: AnyApp, size: tuple[int, int] | None = None) -> None:
        self.app, self.size = app, size
        if size and (refusal := self.refusal(*size)):
            raise ValueError(f"--size {size[0]}x{size[1]}: {app.name} {refusal}.")
        self._kept: tuple[Params, Task, Any] | None = None

    def kept(self, theta: Params, task: Task, make: Callable[[], AnyMade]) -> AnyMade:
        """The source of both `files` and `surface`, made once where they are asked for the same fit in turn.

        Args:
            theta: the fit; other mappings and tasks count as others, whatever is in them.
            task: what was fitted.
            make: makes it, of `size`.
        """
        if self._kept is None or self._kept[0] is not theta or self._kept[1] is not task:
            self._kept = None  # may be 0.6 GB, which should not lie beside the next fit's
            self._kept = theta, task, make()
        made: AnyMade = self._kept[2]
        return made

    def refusal(self, height: int, width: int) -> str:
        """Why `files` cannot be of a size; "" where they can."""
        return "has files of one size; leave it out"

    @abstractmethod
    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Linear RGB pictures [H, W, 3 or 4] of one fitted task and its reference, by name (no task axis in theta)."""

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The files that a fit makes for its user, by the file's name without its ending (no task axis in theta)."""
        return {}

    def surface(self, theta: Params, task: Task) -> Surface | None:
        """The flat surface that a fit is of (no task axis in theta); None of applications that have none."""
        return None

    def maps(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Linear maps of a fit (no task axis in theta), [H, W] or [H, W, 3], by name; {} of one that has none."""
        surface = self.surface(theta, task)
        return {} if surface is None else linear_maps(surface)

    def compared(self, theta: Params, task: Task) -> Compared | None:
        """Pictures that extensions measure, where there is a reference (no task axis in theta)."""
        return None

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """Measures of the pictures that fits of a task make, by the fit's name, then by the measure's, such as SSIM.

        There may be further names, of pictures that are made without any fit; REFERENCE is of the references' own
        error. Of SSIM more is better, of others less, unless extensions say so of theirs. Empty where there are none.
        """
        pairs = {name: self.compared(fit.theta, task) for name, fit in fits.items()}
        measured = {name: pair.measures(self.app.name) for name, pair in pairs.items() if pair}
        return {name: values for name, values in measured.items() if values}

    def visible(self, task: Task) -> Visible | None:
        """The amount that a fit may see of a task; None where the application does not say."""
        return None
