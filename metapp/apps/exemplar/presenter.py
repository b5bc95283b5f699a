"""The presenter of pictures that are generated from noise: their size, and warnings about structure that they lost.

The presenters of textures and of stationary svBRDFs extend the class here; they say how a picture is made of the
network's output.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.doubts import BROKEN_LINES_OF_TEXTURE, LOST_ORDER, REPETITION, VISIBLE_CUTS, Doubt
from metapp.appearance.lattice import find_lattice, kept_order_share, remove_quadratic_trend
from metapp.appearance.lines import compare_lines
from metapp.appearance.presenter import Presenter
from metapp.appearance.uniform import collapsed_fit_warnings
from metapp.learning.task import Params, Task, Tasks, add_task_axis
from metapp.networks.quilted import copied_share, repeated_share, seam_strength

MIN_FILE_PX = 16  # shortest side of pictures in files
LARGEST_PX = 4096  # longest side of pictures in files


class ExemplarPresenter(Presenter[Any]):
    """The presenter of pictures or maps that a network generates from noise, like one exemplar.

    Attributes:
        broken_lines: the doubt about a picture by the strength of its lines over the exemplar's.
    """

    broken_lines: ClassVar[Doubt] = BROKEN_LINES_OF_TEXTURE

    @override
    def size_refusal(self, height: int, width: int) -> str:
        step = self.app.decoder.file_side_step
        smallest = max(MIN_FILE_PX, 2 * step)
        is_possible = all(smallest <= side <= LARGEST_PX and side % step == 0 for side in (height, width))
        multiples = f"multiples of {step} from " if step > 1 else ""
        return "" if is_possible else f"expects {multiples}{smallest} to {LARGEST_PX}"

    @torch.no_grad()
    def generate_shown(self, theta: Params) -> Any:
        """Generate the answer [1, 1, ...] that is shown of a fit at the exemplar's size, from one noise for all fits.

        Args:
            theta: the fit, without a task axis.
        """
        theta, decoder = add_task_axis(theta), self.app.decoder
        return decoder.generate(theta, decoder.shown_noise(theta["z"]))

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Return, for each task, at most one clause on what the fit's picture at the exemplar's size has lost.

        The first that holds: the picture is black or uniform, has lost regular structure, breaks lines, shows cuts
        between pieces, or repeats itself. There are clauses only where networks read quilts.
        """
        if "quilt" not in theta:
            return super().quality_warnings(theta, tasks)
        decoder, statistics = self.app.decoder, self.app.sight.statistics
        data = {key: value[tasks.rows] for key, value in tasks.data.items()}
        prediction = decoder.generate(theta, decoder.shown_noise(tasks.rows)).prediction
        exemplars = decoder.octaves.take_exemplar(data["image"].float() / 255)
        pictures = exemplars, statistics.render_prediction(prediction, data)[:, 0]
        collapse_warnings = [
            collapsed_fit_warnings(picture, exemplar) for exemplar, picture in zip(*pictures, strict=True)
        ]
        exemplars, evenly_lit = (statistics.even_light(photos, data) for photos in pictures)
        comparisons = zip(
            collapse_warnings,
            exemplars.cpu(),
            evenly_lit.cpu(),
            theta["quilt"].cpu(),
            theta["places"].cpu(),
            strict=True,
        )
        return [
            clauses or self._find_lost(exemplar, picture) or self._find_visible_pieces(exemplar, quilt, places)
            for clauses, exemplar, picture, quilt, places in comparisons
        ]

    def _find_lost(self, exemplar: Tensor, picture: Tensor) -> list[str]:
        """Return a clause on structure of an exemplar that is lost, or none.

        Args:
            exemplar: the exemplar, [3, H, W], evenly lit.
            picture: the fit's picture of that size, evenly lit.
        """
        lost = LOST_ORDER.about(kept_order_share(find_lattice(exemplar), picture))
        return lost or self.broken_lines.about(compare_lines(exemplar, picture))

    def _find_visible_pieces(self, exemplar: Tensor, quilt: Tensor, places: Tensor) -> list[str]:
        """Return a clause on pieces of a quilt that an eye tells from each other or finds again, or none.

        Args:
            exemplar: the exemplar, [3, H, W], evenly lit.
            quilt: the quilt, [3, H, W].
            places: the places of its cells in the exemplar, [2, rows, columns].
        """
        even, cells = remove_quadratic_trend(exemplar), self.app.decoder.octaves.octave_size()
        if clauses := VISIBLE_CUTS.about(seam_strength(even, quilt, places, cells)):
            return clauses
        repeats = REPETITION.about(repeated_share(places, cells))
        return [] if repeats and find_lattice(even).repeats else repeats

    @override
    def remarks(self, theta: Params, task: Task) -> Mapping[str, object]:
        """Add figures of quilts to records.

        These are `copied`, the share of the picture that is a copy of the photo, but for its light, and `repeated`, the
        largest share that comes back at one shift.
        """
        if "places" not in theta:
            return super().remarks(theta, task)
        places, cells = theta["places"].cpu(), self.app.decoder.octaves.octave_size()
        figures = {"copied": copied_share(places, cells), "repeated": repeated_share(places, cells)}
        return {**super().remarks(theta, task), **figures}
