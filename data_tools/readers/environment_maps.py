"""HDR environment maps (lat-long EXR, Radiance HDR), as tasks of illumination."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from data_tools.random_streams import Rng, random_stream
from data_tools.readers.arrays import picture_values, pixels_of
from data_tools.readers.colours import LINEAR_SPACE, ColourSpace, Floats, is_linear, linear_rgb
from data_tools.readers.image_files import (
    ALL_PICTURE_SUFFIXES,
    check_exists,
    check_size,
    is_readable_image,
    open_largest_picture,
    read_pixels,
    shape_of,
)
from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.listing import files_of, find_files
from data_tools.readers.square_photos import photo_fault
from metapp.appearance.latlong import mean_luminance, resample_maps
from metapp.appearance.photograph import photograph_spheres
from metapp.learning.task import Task
from metapp.names import input_formats
from metapp.storage.folders import cached_lookup

MAP_HEIGHT_PX, MAP_WIDTH_PX = 64, 128
SPHERE_PHOTO_PX, SPHERE_PHOTO_COUNT = 64, 4  # px and number of the photographs of a map
UNITS = {
    "map": "lat-long radiance, linear Rec.709 [3, 64, 128], rows from the top (+y), the middle column looks to +z; "
    "mean luminance over the sphere 1",
    "scale": "mean luminance of the map before, in the unit of its file",
    "photos": "spheres seen from +z, display values, uint8 0..255 [count, 3, 64, 64], rows from the top; black outside",
}

_SUFFIXES = (".exr", ".hdr", ".rgbe")
_FLOATS = ("half", "float", "double")
_NEGATIVE = 1e-3  # of all light: far more than compression and conversions leave around 0
_EXPECTED = "expected an HDR map (.exr or .hdr)"


def is_latlong(height: int, width: int) -> bool:
    """True if a picture is twice as wide as high, but for a row."""
    return abs(width - 2 * height) <= 2


def read_task(path: Path, rows: int = MAP_HEIGHT_PX, fov_rad: float = 0.0, observe: str = "", layer: str = "") -> Task:
    """An HDR map as a task of so many rows, as `make_map_task`, named by the file's stem; errors as of `read_map`.

    Args:
        path, rows, layer: as of `read_map`.
        fov_rad, observe: as of `task_of_object`.
    """
    if observe == "photo" and not is_latlong(*shape_of(path)):
        task: Task = _photo_reader(str(path)).task_of_pixels(read_pixels(path, layer), str(path), rows, fov_rad)
        return task._replace(name=path.stem)
    return make_map_task(path.stem, read_map(path, rows, layer), _draws(path.stem), rows)


def task_of_object(
    source: object, name: str, rows: int = MAP_HEIGHT_PX, fov_rad: float = 0.0, observe: str = "", **_: object
) -> Task:
    """The task of an environment map in memory, or of the photograph of a ball.

    Args:
        source: linear Rec.709 radiance, floating point, lat-long [H, 2 H, 3] or gray [H, 2 H], rows from the top (+y),
            the middle looks to +z; or the photograph of a ball, a picture as of `pixels_of`.
        name: of the task.
        rows, fov_rad: as of the reader.
        observe: "reference" refuses floating-point values of another shape, which else are a photograph.

    Raises:
        ValueError: neither; as the reader.
    """
    if isinstance(source, np.ndarray | Tensor):
        values = picture_values(name, source)
        is_float, (height, width) = values.dtype.kind == "f", values.shape[:2]
        if is_float and is_latlong(height, width):
            check_size(width, height, name)
            with np.errstate(over="ignore"):  # what is infinite is refused
                return make_map_task(
                    name, _light_of(values.astype(np.float32), LINEAR_SPACE, name, rows), _draws(name), rows
                )
        if is_float and observe == "reference":
            raise ValueError(
                f"{name}: an array {list(values.shape)}, expected linear radiance [H, 2 H, 3]; leave --observe "
                "reference out if it is the photo of a ball."
            )
    task: Task = _photo_reader(name).task_of_pixels(pixels_of(name, source), name, rows, fov_rad)
    return task


def _photo_reader(name: str) -> ModuleType:
    """The reader of photographs of balls; ValueError if there is none."""
    forms = input_formats("illumination").values()
    readers: list[ModuleType] = [form.load() for form in forms if hasattr(form.load(), "task_of_pixels")]
    if not readers:
        raise ValueError(f"{name}: a picture, expected {', '.join(form.inputs for form in forms)}.")
    return readers[0]


def _draws(name: str) -> Rng:
    """The random numbers of a map's photographs, which depend on its name alone."""
    return random_stream(*hashlib.sha256(name.encode()).digest())


def make_map_task(name: str, light: Tensor, rng: Rng, rows: int = MAP_HEIGHT_PX) -> Task:
    """A map, linear Rec.709 radiance [3, H, W] >= 0, not black, as a task.

    Returns:
        `map` [3, rows, 2 * rows] of mean luminance 1, `scale` [], the mean luminance before, and `photos` uint8
        [4, 3, 64, 64] of spheres under the map, of materials and cameras that `rng` draws.
    """
    light = resample_maps(light.float(), rows, 2 * rows)
    scale = mean_luminance(light)
    light = light / scale
    seeded = torch.Generator().manual_seed(int(rng.integers(2**63)))
    photos = photograph_spheres(light.expand(SPHERE_PHOTO_COUNT, -1, -1, -1), seeded, SPHERE_PHOTO_PX)
    return Task(name, {"map": light, "scale": scale, "photos": (photos * 255).round().to(torch.uint8)})


@cached_lookup
def is_map(path: Path) -> bool:
    """True if a file is an HDR image, which holds floating-point values."""
    if path.suffix.lower() in _SUFFIXES:
        return True
    if not is_readable_image(path):
        return False
    with open_largest_picture(path) as source:
        return str(source.spec().format) in _FLOATS


def recognises(path: Path) -> bool:
    """True for an HDR image, and for a folder with one below it."""
    return any(map(is_map, files_of(path, ALL_PICTURE_SUFFIXES)))


def find(path: Path) -> Sources:
    """Find HDR maps, as `find_files`; the error of a named file comes when it is read."""

    def fault(file: Path) -> str | None:
        if line := photo_fault(file):
            return line
        return "" if is_map(file) else f"{file}: not an HDR map, {_EXPECTED}."

    nothing = f"no map in this folder, {_EXPECTED}; name the folder of the maps."
    return sources_of_files(find_files(path, check_exists, fault, nothing), protocol="reference")


def read_map(path: str | Path, height: int = MAP_HEIGHT_PX, layer: str = "") -> Tensor:
    """A lat-long map, averaged over solid angle: linear Rec.709 radiance, float32 [3, height, 2 * height], >= 0.

    Negative values become 0, if together they are less than 0.1 % of the light, and so do colours that Rec.709 cannot
    hold.

    Raises:
        ValueError: as `read_pixels`; an LDR image; not 2 : 1 (but for a row); no linear space;
            NaN, infinite or negative values; a black map.
    """
    pixels = read_pixels(path := Path(path), layer, is_map=True)
    if pixels.values.dtype.kind != "f":
        raise ValueError(
            f"{path}: an LDR image ({pixels.values.dtype}), {_EXPECTED}; a photograph of a sphere is an input of fits."
        )
    _check_shape(path, *pixels.values.shape[:2])
    if not is_linear(pixels.space):
        name = getattr(pixels.space, "name", pixels.space)
        raise ValueError(
            f"{path}: colours in {name!a}, expected a linear space such as Rec.709, Rec.2020 or ACEScg; export the map "
            "with linear colours."
        )
    return _light_of(pixels.values[..., :3], pixels.space, path, height)


def _check_shape(subject: Path | str, height: int, width: int) -> None:
    if not is_latlong(height, width):
        raise ValueError(
            f"{subject}: {width}x{height} px{_layout(height, width)}, expected a lat-long map, twice as wide as high; "
            "convert it to one; a photograph of a sphere is for fits with --observe photo."
        )
    check_size(width, height, subject)


def _layout(height: int, width: int) -> str:
    """The layouts of maps that have such a ratio of sides, in words; "" for none."""
    layouts = {
        (1, 1): "an angular map or a photograph of a sphere",
        (4, 3): "a cross of a cube map",
        (3, 4): "a cross of a cube map",
        (6, 1): "a strip of a cube map's faces",
        (1, 6): "a strip of a cube map's faces",
    }
    words = next((words for (wide, high), words in layouts.items() if width * high == height * wide), "")
    return f", the shape of {words}" if words else ""


def _light_of(radiance: Floats, space: ColourSpace, subject: Path | str, height: int) -> Tensor:
    """A whole map [H, W, 3] of a linear space as `read_map` gives it; `subject` begins errors."""
    planes = [radiance[..., channel] for channel in range(3)]
    _check_values(planes, subject)
    stored = [resample_maps(torch.from_numpy(np.ascontiguousarray(plane)), height, 2 * height) for plane in planes]
    light = torch.from_numpy(linear_rgb(torch.stack(stored, -1).numpy(), space)).permute(2, 0, 1).clamp_min(0)
    if not mean_luminance(light) > 0:
        raise ValueError(f"{subject}: black all over, expected a map with some light; leave it out.")
    return light


def _check_values(planes: Sequence[Floats], subject: Path | str) -> None:
    # A mean is not finite if any value is not; it costs less than looking at each.
    with np.errstate(invalid="ignore"):
        mean = float(sum(plane.mean(dtype=np.float64) for plane in planes)) / 3
    if not np.isfinite(mean):
        count = sum(int((~np.isfinite(plane)).sum()) for plane in planes)
        raise ValueError(
            f"{subject}: {count:,} values are NaN or infinite, expected finite radiance; clamp them and export it "
            "again."
        )
    negative = -float(sum(plane.clip(max=0).mean(dtype=np.float64) for plane in planes)) / 3
    if negative > _NEGATIVE * abs(mean):
        lowest = min(float(plane.min()) for plane in planes)
        raise ValueError(
            f"{subject}: radiance down to {lowest:.3g} at a mean of {mean:.3g}, expected none below 0; clamp it and "
            "export the map again."
        )
