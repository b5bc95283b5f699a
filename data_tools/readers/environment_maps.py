"""HDR environment maps (lat-long EXR, Radiance HDR) as tasks of illumination.

The photographs of a task are rendered here, of spheres under the map; photographs that users took of balls are read
elsewhere, by the reader that `_find_photo_reader` looks up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from data_tools.random_streams import Rng, random_stream
from data_tools.readers.arrays import picture_values, pixels_of
from data_tools.readers.colours import LINEAR_SPACE, ColourSpace, Floats, is_linear, linear_rgb
from data_tools.readers.image_files import check_size, is_readable_image, read_pixels, shape_of
from data_tools.readers.input_source import REFERENCE_FACT, Sources, sources_of_files
from data_tools.readers.listing import files_of, find_files
from data_tools.readers.opened_images import ALL_PICTURE_SUFFIXES, check_exists, open_largest_picture
from data_tools.readers.square_photos import photo_fault
from metapp.appearance.latlong import mean_luminance, resample_maps
from metapp.appearance.photograph import photograph_spheres
from metapp.application import Facts
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.storage.folders import cached_lookup

MAP_HEIGHT_PX, MAP_WIDTH_PX = 64, 128  # size of maps unless another is asked for
SPHERE_PHOTO_PX, SPHERE_PHOTO_COUNT = 64, 4  # side, and number, of the photographs that are rendered of a map
UNITS = {
    "map": "lat-long radiance, linear Rec.709 [3, 64, 128], rows from the top (+y), the middle column looks to +z; "
    "mean luminance over the sphere 1",
    "scale": "mean luminance of the map before, in the unit of its file",
    "photos": "spheres seen from +z, display values, uint8 0..255 [count, 3, 64, 64], rows from the top; black outside",
}

_HDR_SUFFIXES = (".exr", ".hdr", ".rgbe")
_FLOAT_FORMATS = ("half", "float", "double")
_MAX_NEGATIVE_SHARE = 1e-3  # share of all light: far more than compression and conversions leave around 0
_EXPECTED_MAP = "expected an HDR map (.exr or .hdr)"


def is_latlong(height: int, width: int) -> bool:
    """Tell whether a picture of these sides, in px, is twice as wide as high, give or take one row."""
    return abs(width - 2 * height) <= 2


def read_task(path: Path, rows: int = MAP_HEIGHT_PX, fov_rad: float = 0.0, observe: str = "", layer: str = "") -> Task:
    """Read an HDR map, or a photograph of a ball, as a task named by the file's stem.

    Args:
        path: the file.
        rows: the number of rows of the map in the task.
        fov_rad: the field of view, in rad, of the camera of a photograph; 0 if it is not known.
        observe: "photo" reads an image that is not lat-long as the photograph of a ball.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Raises:
        ValueError: the file cannot be read; see :func:`read_map`.
    """
    if observe == "photo" and not is_latlong(*shape_of(path)) and not (pixels := read_pixels(path, layer)).is_panorama:
        task: Task = _find_photo_reader(str(path)).task_of_pixels(pixels, str(path), rows, fov_rad)
        return task._replace(name=path.stem)
    return make_map_task(path.stem, read_map(path, rows, layer), _random_stream_of(path.stem), rows)


def task_of_object(
    source: object, name: str, rows: int = MAP_HEIGHT_PX, fov_rad: float = 0.0, observe: str = "", **_: object
) -> Task:
    """Make the task of an environment map in memory, or of the photograph of a ball.

    Args:
        source: linear Rec.709 radiance, floating point, lat-long [H, 2 H, 3] or gray [H, 2 H], rows from the top (+y),
            the middle looks to +z; or the photograph of a ball, a picture that :func:`pixels_of` reads.
        name: the name of the task.
        rows: the number of rows of the map in the task.
        fov_rad: the field of view, in rad, of the camera of a photograph; 0 if it is not known.
        observe: "reference" refuses floating-point values of another shape, which otherwise are a photograph.

    Raises:
        ValueError: the source is neither; or see :func:`read_map`.
    """
    if isinstance(source, np.ndarray | Tensor):
        values = picture_values(name, source)
        is_float, (height, width) = values.dtype.kind == "f", values.shape[:2]
        if is_float and is_latlong(height, width):
            check_size(width, height, name)
            with np.errstate(over="ignore"):  # values that overflow are refused as infinite
                return make_map_task(
                    name,
                    _resample_light(values.astype(np.float32), LINEAR_SPACE, name, rows),
                    _random_stream_of(name),
                    rows,
                )
        if is_float and observe == "reference":
            raise ValueError(
                f"{name}: an array {list(values.shape)}, expected linear radiance [H, 2 H, 3]; leave --observe "
                "reference out if it is the photo of a ball."
            )
    task: Task = _find_photo_reader(name).task_of_pixels(pixels_of(name, source), name, rows, fov_rad)
    return task


def _find_photo_reader(name: str) -> ModuleType:
    """Return the reader of photographs of balls, which the registry may hold.

    Raises:
        ValueError: there is none.
    """
    formats = registry().applications["illumination"].input_formats.values()
    readers: list[ModuleType] = [
        input_format.load() for input_format in formats if hasattr(input_format.load(), "task_of_pixels")
    ]
    if not readers:
        raise ValueError(f"{name}: a picture, expected {', '.join(input_format.inputs for input_format in formats)}.")
    return readers[0]


def _random_stream_of(name: str) -> Rng:
    """Return the random numbers of a map's photographs, which depend on its name alone."""
    return random_stream(*hashlib.sha256(name.encode()).digest())


def make_map_task(name: str, light: Tensor, rng: Rng, rows: int = MAP_HEIGHT_PX) -> Task:
    """Make the task of an environment map.

    Args:
        name: the name of the task.
        light: linear Rec.709 radiance [3, H, W], >= 0, not black everywhere.
        rng: the random numbers that choose materials and cameras of the photographs.
        rows: the number of rows of the map in the task.

    Returns:
        `map` [3, rows, 2 * rows] of mean luminance 1, `scale` [], the mean luminance before, and `photos` uint8
        [4, 3, 64, 64], display values, of spheres under the map.
    """
    light = resample_maps(light.float(), rows, 2 * rows)
    scale = mean_luminance(light)
    light = light / scale
    generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
    photos = photograph_spheres(light.expand(SPHERE_PHOTO_COUNT, -1, -1, -1), generator, SPHERE_PHOTO_PX)
    return Task(name, {"map": light, "scale": scale, "photos": (photos * 255).round().to(torch.uint8)})


@cached_lookup
def is_map(path: Path) -> bool:
    """Tell whether a file is an HDR image, which holds floating-point values."""
    if path.suffix.lower() in _HDR_SUFFIXES:
        return True
    if not is_readable_image(path):
        return False
    with open_largest_picture(path) as source:
        return str(source.spec().format) in _FLOAT_FORMATS


def recognises(path: Path) -> bool:
    """Tell whether a path is an HDR image, or a folder with one at any depth."""
    return any(map(is_map, files_of(path, ALL_PICTURE_SUFFIXES)))


def facts_of(tensors: Mapping[str, object]) -> Facts:
    """Return the fact that the tensors of a task state: whether its map is known.

    Args:
        tensors: tensors by name; values are not read.
    """
    return {REFERENCE_FACT: "map" in tensors}


def find(path: Path) -> Sources:
    """Find the HDR maps at a path; see :func:`find_files`.

    A named file must exist; other faults of it are found when it is read.
    """

    def fault(file: Path) -> str | None:
        if line := photo_fault(file):
            return line
        return "" if is_map(file) else f"{file}: not an HDR map, {_EXPECTED_MAP}."

    nothing = f"no map in this folder, {_EXPECTED_MAP}; name the folder of the maps."
    return sources_of_files(find_files(path, check_exists, fault, nothing))


def read_map(path: str | Path, height: int = MAP_HEIGHT_PX, layer: str = "") -> Tensor:
    """Read a lat-long map, averaged over solid angle.

    Negative values become 0, if together they are less than 0.1 % of the light, and so do colours that Rec.709 cannot
    hold.

    Args:
        path: the file.
        height: the number of rows of the result.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Returns:
        Linear Rec.709 radiance, float32 [3, height, 2 * height], >= 0.

    Raises:
        ValueError: the file cannot be read (see :func:`read_pixels`); it is an LDR image; its sides are not 2 : 1 (give
            or take one row); its space is not linear; it holds NaN, infinite or negative values, or is black.
    """
    pixels = read_pixels(path := Path(path), layer, is_map=True)
    if pixels.values.dtype.kind != "f":
        found = f"an LDR image ({pixels.values.dtype})"
        raise ValueError(f"{path}: {found}, {_EXPECTED_MAP}; a photograph of a sphere is an input of fits.")
    _check_shape(path, *pixels.values.shape[:2])
    if not is_linear(pixels.space):
        name = getattr(pixels.space, "name", pixels.space)
        raise ValueError(
            f"{path}: colours in {name!a}, expected a linear space such as Rec.709, Rec.2020 or ACEScg; export the map "
            "with linear colours."
        )
    return _resample_light(pixels.values[..., :3], pixels.space, path, height)


def _check_shape(subject: Path | str, height: int, width: int) -> None:
    """Raise ValueError for an image that is not lat-long, or has too few or too many px."""
    if not is_latlong(height, width):
        found = f"{width}x{height} px{_describe_layout(height, width)}"
        raise ValueError(
            f"{subject}: {found}, expected a lat-long map, twice as wide as high; convert it to one; a photograph of a "
            "sphere is for fits with --observe photo."
        )
    check_size(width, height, subject)


def _describe_layout(height: int, width: int) -> str:
    """Return the layouts of maps that have this ratio of sides, in words for an error; "" for none."""
    layouts = {
        (1, 1): "an angular map or a photograph of a sphere",
        (4, 3): "a cross of a cube map",
        (3, 4): "a cross of a cube map",
        (6, 1): "a strip of a cube map's faces",
        (1, 6): "a strip of a cube map's faces",
    }
    words = next((words for (wide, high), words in layouts.items() if width * high == height * wide), "")
    return f", the shape of {words}" if words else ""


def _resample_light(radiance: Floats, space: ColourSpace, subject: Path | str, height: int) -> Tensor:
    """Convert a whole map to linear Rec.709 and resample it.

    Args:
        radiance: the values of the file, [H, W, 3].
        space: their colour space, a linear one.
        subject: the name of the map in errors.
        height: the number of rows of the result.

    Returns:
        Radiance, float32 [3, height, 2 * height], >= 0.
    """
    planes = [radiance[..., channel] for channel in range(3)]
    _check_values(planes, subject)
    resampled = [resample_maps(torch.from_numpy(np.ascontiguousarray(plane)), height, 2 * height) for plane in planes]
    light = torch.from_numpy(linear_rgb(torch.stack(resampled, -1).numpy(), space)).permute(2, 0, 1).clamp_min(0)
    if not mean_luminance(light) > 0:
        raise ValueError(f"{subject}: black all over, expected a map with some light; leave it out.")
    return light


def _check_values(planes: Sequence[Floats], subject: Path | str) -> None:
    # a mean is not finite if any value is not, and costs less than a test of each value
    """Raise ValueError for planes [H, W] of radiance that are not finite, or whose negative values matter."""
    with np.errstate(invalid="ignore"):
        mean = float(sum(plane.mean(dtype=np.float64) for plane in planes)) / 3
    if not np.isfinite(mean):
        count = sum(int((~np.isfinite(plane)).sum()) for plane in planes)
        raise ValueError(
            f"{subject}: {count:,} values are NaN or infinite, expected finite radiance; clamp them and export it "
            "again."
        )
    negative = -float(sum(plane.clip(max=0).mean(dtype=np.float64) for plane in planes)) / 3
    if negative > _MAX_NEGATIVE_SHARE * abs(mean):
        lowest = min(float(plane.min()) for plane in planes)
        raise ValueError(
            f"{subject}: radiance down to {lowest:.3g} at a mean of {mean:.3g}, expected none below 0; clamp it and "
            "export the map again."
        )
