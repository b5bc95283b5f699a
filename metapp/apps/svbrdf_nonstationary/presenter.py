"""The presenter of non-stationary svBRDFs: maps, pictures of them under flashes and other lights, and warnings.

One presenter serves fits of maps, of one photograph and of several: it gets maps from methods of the application, and
knows no network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb, radiance_to_display, srgb_to_linear
from metapp.appearance.flash_rendering import camera_position
from metapp.appearance.highlight import F0_BOUND_CLAUSE, clipped_highlight_warnings, find_clipped, format_percent
from metapp.appearance.pictures import Picture, PictureComparison, VisibleData
from metapp.appearance.presenter import Presenter
from metapp.appearance.surface import Surface, map_pictures, photograph_maps, scale_relief
from metapp.appearance.svbrdf_maps import Maps, mean_tilt_degrees, unpack_maps
from metapp.appearance.uniform import black_fit_warnings
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, RADIANCE_FLOOR, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.flashes import Flash, render_photo
from metapp.apps.svbrdf_nonstationary.maps import decode_photo, pool_maps
from metapp.learning.task import Params, Task, Tasks, add_task_axis

LARGEST_PX = 4096  # longest side of maps in files
SHOWN_PX = 256  # longest side of maps that are shown
# Fits of several photographs, on 12 simulated sets of hand-held ones: where fitted normals are tilted by 1.4 to 1.9
# degrees on average, they are off by 0.8 of true tilts and more; where by 4.9 degrees and more, by 0.2 to 0.6, but for
# one set of three photographs.
MIN_TILT_DEGREES = 3.0
# Deviation of the logs of photographs from those of renderings, averaged over so many blocks a side: up to 0.007, but
# 0.043 for the set of three photographs, whose normals are off by 0.94 of true tilts.
MAX_LOG_DIFFERENCE, COMPARED_BLOCKS = 0.02, 8
# Median |difference| of the logs of photographs and renderings: 0.001 to 0.002 for photographs at exact places; where a
# phone took them, 0.007 to 0.031, and above it 6 of 7 sets.
MAX_NOISE = 0.01
MIN_HIDDEN_SHARE = 0.01  # of a photograph that is said to lie beneath a highlight


@dataclass(frozen=True)
class SvbrdfNonstationaryPresenter(Presenter[SvbrdfNonstationary]):
    """The presenter of maps of a flat material: with photographs as the fit sees them, and under other lights.

    Applications that extend :class:`SvbrdfNonstationary` are shown by it, too: it asks them for maps and flashes.

    Attributes:
        relief: the factor of slopes of normals in files and pictures; errors are without it.
    """

    relief: float = 1.0
    picture_measure = "renderings under 12 other lights, at gamma 2.2"

    @override
    def size_refusal(self, height: int, width: int) -> str:
        is_possible = height == width and 32 <= height <= LARGEST_PX
        return "" if is_possible else f"expects square maps of 32 to {LARGEST_PX} px, as photos are cut to a square"

    @override
    @torch.no_grad()
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return four maps above pictures of them under the flash and three other lights, beside the true ones."""
        maps, photo = self._small_maps(theta, task)
        reference = {}
        if "maps" in task.data:
            reference = {"reference": _draw_sheet(unpack_maps(pool_maps(task.data["maps"].float(), photo.shape[-2:])))}
        return reference | {"fit": _draw_sheet(scale_relief(maps, self.relief))}

    @override
    @torch.no_grad()
    def tiles(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the photograph, the fit under its flash, maps, and the fit under three other lights."""
        comparison, (maps, photo) = self.photo_comparison(theta, task), self._small_maps(theta, task)
        eye = camera_position()
        fitted_photo = photograph_maps(maps, eye, eye) if comparison is None else comparison.pictures[0]
        tiles = {"photo": photo[0].permute(1, 2, 0), "fit": srgb_to_linear(fitted_photo).permute(1, 2, 0)}
        tiles |= _draw_linear_maps(scale_relief(maps, self.relief))
        if "maps" in task.data:
            target = _draw_linear_maps(unpack_maps(pool_maps(task.data["maps"].float(), photo.shape[-2:])))
            tiles |= {f"reference {name}": picture for name, picture in target.items()}
        return tiles

    @override
    @torch.no_grad()
    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Return the maps, of the size asked for, else of the photograph's, and pictures under three other lights.

        Fits of several photographs also have `photo_1` and so on: the maps as each photograph shows them.
        """
        maps = self._shown_maps(theta, task)
        pictures = map_pictures(scale_relief(maps, self.relief))
        if self.app.several_photos:
            for number, flash in enumerate(self.app.flashes(theta, task), 1):
                radiance = _photograph_by(flash, Maps(*(part[None] for part in maps)))
                pictures[f"photo_{number}"] = Picture(linear_to_srgb(radiance.clamp(0, 1)).permute(1, 2, 0), "srgb")
        return pictures

    @override
    def prediction_pictures(self, prediction: Maps, task: Task) -> dict[str, Picture]:
        """Return the pictures of maps [1, C, H, W], of their size."""
        return map_pictures(Maps(*(part[0] for part in prediction)))

    @override
    @torch.no_grad()
    def surface(self, theta: Params, task: Task) -> Surface:
        maps = scale_relief(self._shown_maps(theta, task), self.relief)
        return Surface(maps.diffuse, False, maps)

    @override
    @torch.no_grad()
    def comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return the renderings that errors are of, as displays of gamma 2.2 show them."""
        if "maps" not in task.data:
            return None
        data = add_task_axis(self.app.prepare(task))
        fitted_maps = self.app.final_maps(add_task_axis(theta), data["photo"])
        log_pictures = (self.app.judged_radiance(maps)[0] for maps in (fitted_maps, unpack_maps(data["maps"])))
        return PictureComparison(*(radiance_to_display(logs.exp() - RADIANCE_FLOOR) for logs in log_pictures))

    @override
    @torch.no_grad()
    def photo_comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return the maps under each photograph's flash, as the fit places it."""
        if self.app.observes != "photo":
            return None
        flashes = self.app.flashes(theta, task)
        photos = torch.stack([task.data["photo"], *task.data.get("others", ())])[: len(flashes)]
        photos = adaptive_avg_pool2d(decode_photo(photos), min(SHOWN_PX, photos.shape[-1]))
        maps = self.app.final_maps(add_task_axis(theta), photos[:1])
        pictures = torch.stack([_photograph_by(flash, maps) for flash in flashes])
        return PictureComparison(linear_to_srgb(pictures.clamp(0, 1)), linear_to_srgb(photos))

    @override
    @torch.no_grad()
    def remarks(self, theta: Params, task: Task) -> Mapping[str, object]:
        """Return the number of photographs, if fits see several, and where they see photographs alone, the mean tilt.

        `mean_tilt_degrees` is the mean tilt of fitted normals, without the factor `relief`.
        """
        counts = {"counts": {"photos": self._photo_count(task)}} if self.app.several_photos else {}
        if self.app.observes != "photo":
            return counts
        maps = self.app.maps_of(add_task_axis(theta), _small_photo(task))
        return {"mean_tilt_degrees": mean_tilt_degrees(maps.normal)} | counts

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Return clauses on maps that are black where the photo is not and, where maps are filled, on highlights.

        Fits of several photographs have clauses on clipping, where all photographs clip, on parts of photographs that
        were left out, since they show something else than the material, on relief that is about as low as its errors,
        and on photographs that the maps do not explain.
        """
        app = self.app
        if app.several_photos and app.observes == "photo":
            return [
                self._warn_of_several({key: value[number] for key, value in theta.items()}, tasks.data, row)
                for number, row in enumerate(tasks.rows)
            ]
        photos = tasks.data["photo"][tasks.rows]
        maps = app.maps_of(theta, photos)
        warnings = [
            black_fit_warnings(colours, photo)
            for colours, photo in zip(maps.diffuse + maps.specular, photos, strict=True)
        ]
        if not app.fills:
            return warnings
        displayed_photos = linear_to_srgb(photos)
        shares = find_clipped(displayed_photos).float().mean((1, 2, 3)).tolist()
        effects = [f"{format_percent(share)} of the maps is filled from its surroundings" for share in shares]
        clipped = [clipped_highlight_warnings(*pair) for pair in zip(displayed_photos, effects, strict=True)]
        hidden = [
            [f"{format_percent(share)} of the photo lies beneath a highlight: colours and gloss there are guesses"]
            if share >= MIN_HIDDEN_SHARE
            else []
            for share in app.hidden_share(theta, maps).tolist()
        ]
        return [black + white + under for black, white, under in zip(warnings, clipped, hidden, strict=True)]

    def _warn_of_several(self, theta: Params, data: Mapping[str, Tensor], row: Tensor) -> list[str]:
        """Return the clauses on a fit of several photographs, without task axis, whose data are in a row of `data`."""
        photos, shows_material = data["photos"][row], data["unobstructed"][row]
        maps = self.app.maps_of(add_task_axis(theta), photos[:1])
        flashes = self.app.flashes(theta, Task("", {"places": data["places"][row]}))
        renderings = torch.stack([_photograph_by(flash, maps) for flash in flashes])
        return [
            *clipped_highlight_warnings(linear_to_srgb(photos.amin(0)), F0_BOUND_CLAUSE, "all photos"),
            *_left_out_warnings((1 - shows_material.mean((1, 2, 3))).tolist()),
            *_flat_warnings(mean_tilt_degrees(maps.normal)),
            *_unexplained_warnings(photos, renderings, shows_material),
        ]

    @override
    def visible(self, task: Task) -> VisibleData:
        """Return the maps or all photographs, all of them in each step; General's encoder reads photographs alone."""
        if self.app.observes == "photo":
            count = self._photo_count(task)
            return VisibleData(count, task.data["photo"].nbytes, count)
        return VisibleData(1, task.data["maps"].nbytes, 0)

    def _photo_count(self, task: Task) -> int:
        """Return the number of photographs that a fit sees."""
        return 1 + len(task.data.get("others", ())) if self.app.several_photos else 1

    def _small_maps(self, theta: Params, task: Task) -> tuple[Maps, Tensor]:
        """Return maps [C, h, w] of at most SHOWN_PX a side, as fitted, and the linear photograph [1, 3, h, w]."""
        photo = _small_photo(task)
        return Maps(*(part[0] for part in self.app.final_maps(add_task_axis(theta), photo))), photo

    def _shown_maps(self, theta: Params, task: Task) -> Maps:
        """Return the maps [C, H, W] of the size of files, as fitted."""
        side = self.size[0] if self.size else min(FINEST_PX, task.data["photo"].shape[-1])

        def make() -> Maps:
            photo = _resize_photo(task, side)
            fits = add_task_axis(theta)
            return self.app.fill(fits, self.app.fine_maps(fits, photo), photo)

        maps = self.cache_last(theta, task, make)
        return Maps(*(part[0] for part in maps))


def _flat_warnings(tilt_degrees: float) -> list[str]:
    """Return a clause on the relief of a surface whose normals are tilted by little on average; [] for more relief.

    >>> _flat_warnings(5.0)
    []
    """
    if tilt_degrees >= MIN_TILT_DEGREES:
        return []
    return [
        f"the surface is nearly flat, with normals tilted by {tilt_degrees:.1f} degrees on average: relief is about as "
        "large as its errors"
    ]


def _unexplained_warnings(photos: Tensor, renderings: Tensor, shows_material: Tensor) -> list[str]:
    """Return a clause on how far photographs differ from renderings of the maps; [] where they agree.

    Differences over wide areas come first; else those from texel to texel count, by their median.

    Args:
        photos: linear photographs [N, 3, H, W].
        renderings: the same photographs, rendered from the maps.
        shows_material: 1 where photographs show the material, else 0, [N, 1, H, W].
    """
    logs = (photos + RADIANCE_FLOOR).log() - (renderings.clamp(0, 1) + RADIANCE_FLOOR).log()
    difference = float(adaptive_avg_pool2d(logs.mean(1, keepdim=True) * shows_material, COMPARED_BLOCKS).std())
    if difference > MAX_LOG_DIFFERENCE:
        return [
            f"photos differ from pictures of the maps by {100 * difference:.0f} % over wide areas: a place, a flash or "
            "the surface is not as assumed, and maps may be wrong"
        ]
    noise = float(logs.abs()[shows_material.expand_as(logs) > 0].median())
    if noise <= MAX_NOISE:
        return []
    return [
        f"photos differ from pictures of the maps by {100 * noise:.1f} % from texel to texel, expected up to "
        f"{100 * MAX_NOISE:.0f} %: by relief that moves as the camera does, by places or by the camera's colours; "
        "relief may be wrong"
    ]


def _left_out_warnings(shares: Sequence[float]) -> list[str]:
    """Return a clause on the parts of photographs that were left out, given their shares; [] where none was."""
    parts = [f"{format_percent(share)} of photo {number}" for number, share in enumerate(shares, 1) if share]
    return [f"{' and '.join(parts)} left out, where others disagree: an object or a shadow?"] if parts else []


def _resize_photo(task: Task, side: int) -> Tensor:
    """Return the photograph, linear [1, 3, side, side]: means over areas; a smaller one is interpolated."""
    photo = decode_photo(task.data["photo"])[None]
    enlarges = side > photo.shape[-1]
    return interpolate(photo, size=(side, side), mode="bilinear") if enlarges else adaptive_avg_pool2d(photo, side)


def _small_photo(task: Task) -> Tensor:
    """Return the photograph, linear [1, 3, h, w], of at most SHOWN_PX a side."""
    return _resize_photo(task, min(SHOWN_PX, task.data["photo"].shape[-1]))


def _photograph_by(flash: Flash, maps: Maps) -> Tensor:
    """Return the radiance [3, H, W] of maps [1, C, H, W] under a flash without task axis."""
    return render_photo(maps, Flash(*(part[None] for part in flash)))[0]


def _draw_linear_maps(maps: Maps) -> dict[str, Tensor]:
    """Return the pictures that `map_pictures` makes of maps [C, H, W], linear [H, W, 3]."""
    return {name: srgb_to_linear(picture.pixels).expand(-1, -1, 3) for name, picture in map_pictures(maps).items()}


def _draw_sheet(maps: Maps) -> Tensor:
    """Return a linear picture [2 H, 4 W, 3] of maps [C, H, W]: four maps; below, the flash and three other lights."""
    pictures, eye = map_pictures(maps), camera_position(device=maps.diffuse.device)
    flash = photograph_maps(maps, eye, eye).permute(1, 2, 0)
    map_row = [pictures.pop(name).pixels.expand(-1, -1, 3) for name in ("normal", "diffuse", "roughness", "specular")]
    light_row = [flash, *(picture.pixels for picture in pictures.values())]
    return srgb_to_linear(torch.cat([torch.cat(row, 1) for row in (map_row, light_row)]))
