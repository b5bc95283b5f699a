"""What people look at of fits beside what these saw: titles, pictures beside references, remarks and warnings.

Learning needs none of it: an application works without its presenter, in a notebook for example. What a fit answers
with, its files and exports among it, is its asset, see :mod:`metapp.appearance.assets`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from torch import Tensor

from metapp.appearance.assets import Asset
from metapp.appearance.pictures import PictureComparison, TimedFit
from metapp.application import Application
from metapp.learning.app import App
from metapp.learning.task import Params, Task, Tasks
from metapp.options import AppOptions

PresentedApp = TypeVar("PresentedApp", bound=App)


@dataclass(frozen=True)
class Presenter(Generic[PresentedApp]):
    """What people look at of an application's fits; a subclass shows what its application has.

    Methods that take `theta` and `task` show one fit: `theta` holds parameters without a task axis. The defaults show
    the asset of a fit beside a true one, if :meth:`reference` knows that, so that an application can do without a
    presenter of its own.

    Attributes:
        app: the network and the sizes of the application, at the recipe of the fits.
        application: the application.
        options: the application's own options, of which those about OUTPUT change what is shown.

    >>> from metapp.registry import registry
    >>> brdf = registry().applications["brdf"]
    >>> Presenter(brdf.recipes["quick"].load().app, brdf).title
    'BRDF'
    """

    app: PresentedApp
    application: Application
    options: AppOptions = field(default_factory=AppOptions)

    def __post_init__(self) -> None:
        """Refuse a size that files cannot have.

        Raises:
            ValueError: files of the application cannot have this size.
        """
        if self.size and (refusal := self.size_refusal(*self.size)):
            raise ValueError(f"--size {self.size[0]}x{self.size[1]}: {self.app.name} {refusal}.")

    @property
    def size(self) -> tuple[int, int] | None:
        """The height and width of files that the user asks for, px; None for the usual size."""
        return getattr(self.options, "size", None)

    @property
    def title(self) -> str:
        """The application's title in tables, with what fits observe, if that may differ."""
        title = self.application.title
        return f"{title} ({self.app.observes})" if self.app.observes else title

    @property
    def picture_measure(self) -> str:
        """The pictures that :meth:`picture_errors` and registered measures judge, in one line; "" if there are none."""
        return ""

    def caption(self, *, measured: bool = True) -> str:
        """Return the line below a table of errors: how they are measured, and under which conditions.

        Args:
            measured: whether there are errors; fits of photographs have none, since nothing tells the truth.
        """
        app = self.app
        conditions = ({"fits see": app.observes} if app.observes else {}) | app.recorded_conditions()
        stated = (
            f"error: {app.error_measure.text}{app.error_measure.factor}"
            if measured
            else "without a reference there is no error to state"
        )
        return stated + "".join(f"; {name}: {value}" for name, value in conditions.items())

    def size_refusal(self, height: int, width: int) -> str:
        """Return why files cannot have a size in px, as the end of a sentence; "" if they can."""
        return "has files of one size; leave it out"

    # Pictures of one fit

    def shown(self, theta: Params, task: Task) -> Asset | None:
        """Return the asset of a fit as it is shown beside its reference; the default is the one of files."""
        make = next(iter(self.application.assets.values()), None)
        return make.load()(self.app, theta, task, None) if make else None

    def reference(self, task: Task) -> Asset | None:
        """Return the truth as an asset, at the size of :meth:`shown`; None if it is not known."""
        reference: Asset | None = self.app.judge.reference(task)
        return reference

    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return linear RGB pictures [H, W, 3 or 4]: `fit`, and `reference` or `samples` if the task has them."""
        shown, reference = self.shown(theta, task), self.reference(task)
        previews = {} if reference is None else {"reference": reference.preview()}
        return previews if shown is None else previews | {"fit": shown.preview()}

    def tiles(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return linear RGB pictures [H, W, 3] for the row of a fit in the picture of a run, by name.

        The names `reference` and `photo` stand for pictures of the task; `reference X` is shown below the picture X.
        """
        return self.preview(theta, task)

    # Comparisons and doubts

    def comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return the pictures and references of a fit, which registered measures compare; None if there are none."""
        return None

    def photo_comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return renderings of a fit beside the photographs that it saw; None if it saw something else."""
        return None

    def picture_errors(self, fits: Mapping[str, TimedFit], task: Task) -> dict[str, dict[str, float]]:
        """Return the application's own measures of pictures, by the fit's name, then by the measure's, such as SSIM.

        There may be further names, of pictures that are made without any fit; `pictures.REFERENCE_ERROR_NAME` names
        the error that references have themselves. A higher SSIM is better, and a lower value of all other measures.
        """
        return {}

    def remarks(self, theta: Params, task: Task) -> Mapping[str, object]:
        """Return further entries of the record of a fit.

        `counts` says how many things of a kind the fit sees; `note` is a clause, which is also printed; other entries
        are named by the application.
        """
        return {}

    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Return, for each task, short clauses about faults of its fit that show without a reference; [] for none.

        Args:
            theta: fits [T, ...].
            tasks: the T tasks that were fitted.
        """
        return [[] for _ in range(len(tasks))]
