"""Non-stationary svBRDFs, maps of a flat material from photographs under a flash (paper section 4.1.4: one photograph).

Here is what all fits of such materials share: the tensors of tasks, the maps that they are judged by, and errors. What
a fit sees, and what its parameters are, differ: `coded_maps` has fits of the maps themselves and of one photograph,
`pretrained` has fits of one photograph by features of VGG-16, and `several` fits of several photographs.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d
from typing_extensions import override

from metapp.appearance.flash_rendering import render_maps, texel_positions
from metapp.appearance.svbrdf_maps import Maps, map_statistics, unpack_maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, Flash
from metapp.apps.svbrdf_nonstationary.maps import (
    CLIPPED_LINEAR_VALUE,
    decode_photo,
    draw_mirroring_pairs,
    draw_oblique_pairs,
    map_differences,
    pool_maps,
)
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

RADIANCE_FLOOR = 0.1  # of white: the log of radiance is flat below
LEVEL_SINE = 0.01  # sine of an angle that hardly shows
JUDGED_LIGHTS = (6, 6)  # lights that fits are judged under: anywhere above the patch, mirrored in it
DRAWN_LIGHTS = (1, 2)  # lights that are drawn anew for each outer step: anywhere above the patch, mirrored in it
# Augmented materials are photographed FINER times as fine as fits' maps, up to this side.
FINER, FINEST_SHOT_PX = 2, 256
FINEST_PX = 2048  # longest side at which a user's photograph is read


@dataclass(frozen=True)
class SvbrdfNonstationary(App):
    """The application of non-stationary svBRDFs: a task is one flat material, photographed with a flash.

    A task has `photo`, taken from straight above with the flash beside the lens, and, where they are known, the
    material's `maps`; `others` and `places` are of further photographs.

    Attributes:
        several_photos: whether fits see `others`, too, and place the flash of each photograph.
    """

    network: Any = None
    several_photos: ClassVar[bool] = False
    name = "svbrdf_nonstationary"
    small_tensors = deterministic = True
    error_measure = ErrorMeasure(
        "mean absolute difference of log(radiance + 0.1) under 12 other lights, from elsewhere",
        further={
            "normal": "normals, degrees",
            "diffuse": "diffuse at gamma 2.2",
            "roughness": "roughness",
            "specular": "specular at gamma 2.2",
        },
    )
    tensors: ClassVar = {
        "photo": TensorSpec((3, "S", "S"), "uint8"),
        "maps": TensorSpec((10, "M", "M"), low=-1.001, high=1.001, optional=True),
        "others": TensorSpec(("K", 3, "S", "S"), "uint8", optional=True),
        "predicted": TensorSpec((10, "M", "M"), low=-1.001, high=1.001, optional=True),
        "places": TensorSpec(("N", 2, 3), low=-1e3, high=1e3, optional=True),
    }

    @property
    @override
    def read_size(self) -> int:
        return FINEST_PX

    @property
    def fills(self) -> bool:
        """Whether maps are made up where photographs clip."""
        return False

    @property
    def shot_size(self) -> int:
        """Side in texels of augmented materials when they are photographed."""
        height: int = self.network.height
        return max(height, min(FINER * height, FINEST_SHOT_PX))

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare the photograph and, if they are known, the maps, at the size of fits.

        Returns:
            `photo`, linear [3, H, W]; `maps` [10, H, W] and all that `describe_maps` makes of them; `fine` [10, F, F],
            half precision, which augmented materials are made of; `predicted` [10, H, W], the maps of another method,
            which no fit sees.
        """
        size = (self.network.height, self.network.width)
        prepared = {"photo": adaptive_avg_pool2d(decode_photo(task.data["photo"]), size)}
        if "maps" not in task.data:
            return prepared
        maps = task.data["maps"].float()
        fine_side = min(maps.shape[-1], 2 * self.shot_size)  # twice as large, to have room for crops
        prepared["fine"] = pool_maps(maps, (fine_side, fine_side)).half()
        if "predicted" in task.data:
            prepared["predicted"] = pool_maps(task.data["predicted"].float(), size)
        return prepared | {key: value[0] for key, value in self.describe_maps(pool_maps(maps, size)[None]).items()}

    def describe_maps(self, maps: Tensor) -> dict[str, Tensor]:
        """Return packed maps [T, 10, H, W] as `maps`, for errors, and what fits see of them, by name."""
        return {"maps": maps}

    @override
    def init(self, rng: Generator, count: int) -> Params:
        theta: Params = self.network.init(rng, count)
        return theta | {"flash": torch.zeros(count, FLASH_NUMBERS, device=rng.device)}

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Return all that fits see of each task.

        Where the maps are known, there are also random lights and viewers for outer losses, `pairs` [T, V, 2, 3].
        """
        pairs = {"pairs": draw_pairs(DRAWN_LIGHTS, rng, len(tasks))} if "maps" in tasks.data else {}
        visible = {key: value for key, value in tasks.data.items() if key not in ("fine", "predicted")}
        return {key: value[tasks.rows] for key, value in visible.items()} | pairs

    @abstractmethod
    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        """Return the fitted maps [T, C, h, w] at the size of linear photographs [T, 3, h, w], as losses see them."""

    def fine_maps(self, theta: Params, photo: Tensor) -> Maps:
        """Return the maps of :meth:`maps_of`, for photographs [T, 3, h, w] that may be too large for one pass."""
        return self.maps_of(theta, photo)

    def fill(self, theta: Params, maps: Maps, photo: Tensor) -> Maps:
        """Fill maps [T, C, h, w] where linear photographs [T, 3, h, w] tell little; here maps stay as they are."""
        return maps

    def hidden_share(self, theta: Params, maps: Maps) -> Tensor:
        """Return the share of texels of which a highlight hides the colours, [T]; here 0."""
        return maps.roughness.new_zeros(len(maps.roughness))

    def final_maps(self, theta: Params, photo: Tensor) -> Maps:
        """Return the fitted maps [T, C, h, w] of linear photographs [T, 3, h, w], filled as :meth:`fill` does."""
        return self.fill(theta, self.maps_of(theta, photo), photo)

    def radiance_difference(self, maps: Maps, target: Maps, pairs: Tensor, place: Tensor | None = None) -> Tensor:
        """Return the mean absolute difference of :meth:`log_radiance` of two sets of maps, [T]."""
        logs, references = (self.log_radiance(material, pairs, place) for material in (maps, target))
        return (logs - references).abs().mean((1, 2, 3, 4))

    @abstractmethod
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        """Return the flash of each photograph that a fit saw, without task axis, as the fit places it."""

    def log_radiance(self, maps: Maps, pairs: Tensor, place: Tensor | None = None) -> Tensor:
        """Return log(radiance + RADIANCE_FLOOR), [T, V, 3, H, W], of maps [T, C, H, W].

        Args:
            maps: maps of all of the patch, or of the part of it that `place` says.
            pairs: positions of light and viewer in half sides of the patch, [T or 1, V, 2, 3].
            place: the positions of the texels, [T, 2, H, W]; None if the maps are of all of the patch.
        """
        if place is None:
            place = texel_positions(*maps.diffuse.shape[-2:], dtype=pairs.dtype, device=pairs.device)[None]
        place = place[:, None]
        maps_by_pair = Maps(*(part[:, None] for part in maps))
        return (render_maps(maps_by_pair, place, pairs[:, :, 0], pairs[:, :, 1]) + RADIANCE_FLOOR).log()

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        return self.errors_of(self.final_maps(theta, tasks.data["photo"][tasks.rows]), tasks)

    def errors_of(self, prediction: Maps, tasks: Tasks) -> dict[str, Tensor]:
        """Measure how far maps [T, C, H, W] of the size of fits are off; {} if the true ones are not known.

        Returns:
            `error`, of log radiance under lights that no fit has seen; `normal` in degrees; `diffuse`, `roughness`,
            `specular`, mean differences, colours at gamma 2.2; `relief`, how steep normals are on average over how
            steep they should be; `blots`, the difference of diffuse colours where the photo clips, 0 if it does not.
        """
        if "maps" not in tasks.data:
            return {}
        maps, target = prediction, unpack_maps(tasks.data["maps"][tasks.rows])
        logs, references = self.judged_radiance(maps), self.judged_radiance(target)
        cosine = (maps.normal * target.normal).sum(1).clamp(-1, 1)
        differences = dict(zip(("diffuse", "specular", "roughness"), map_differences(maps, target), strict=False))
        steepness = [map_statistics(material)[:, 0, -1] + LEVEL_SINE for material in (maps, target)]
        photo = tasks.data["photo"][tasks.rows]
        return {
            "error": (logs - references).abs().mean((1, 2, 3, 4)),
            "normal": torch.rad2deg(cosine.acos()).mean((1, 2)),
            "relief": steepness[0] / steepness[1],
            "blots": blots(differences["diffuse"], photo),
            **{name: difference.abs().mean((1, 2, 3)) for name, difference in differences.items()},
        }

    def judged_radiance(self, maps: Maps) -> Tensor:
        """Return log radiance [T, V, 3, H, W] of maps [T, C, H, W] under the lights that fits are judged under."""
        return self.log_radiance(maps, fixed_pairs(JUDGED_LIGHTS).to(maps.diffuse)[None])


def blots(diffuse: Tensor, photo: Tensor) -> Tensor:
    """Return the mean |difference| of diffuse colours where a photograph clips, [T]; 0 where none of it clips.

    Args:
        diffuse: differences of diffuse colours at gamma 2.2, [T, 3, H, W].
        photo: linear photographs [T, 3, H, W].
    """
    clips = (photo > CLIPPED_LINEAR_VALUE).any(1, keepdim=True).float()
    return (diffuse.abs() * clips).mean((1, 2, 3)) / clips.mean((1, 2, 3)).clamp_min(1e-6)


def draw_pairs(counts: tuple[int, int], rng: Generator, tasks: int) -> Tensor:
    """Draw places of light and viewer, [tasks, V, 2, 3]: some anywhere, then some mirrored in the patch."""
    return torch.cat([draw_oblique_pairs(rng, (tasks, counts[0])), draw_mirroring_pairs(rng, (tasks, counts[1]))], 1)


def fixed_pairs(counts: tuple[int, int]) -> Tensor:
    """Return the places of light and viewer, [V, 2, 3], that are the same for all tasks and in every run."""
    return draw_pairs(counts, Generator().manual_seed(sum(counts)), 1)[0]
