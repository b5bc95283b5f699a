"""HDR environment maps (lat-long EXR, Radiance HDR), as tasks of illumination.

A map is linear: in Rec.709, unless its file states other primaries (`chromaticities` of EXR) or names another linear
space, from which it is converted. White stays white (Bradford).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.draws import Rng, stream
from data_tools.readers.image_files import check_exists, check_memory, error_of, opened, opens, reason_of, turn_upright
from data_tools.readers.listing import files_of, find_files
from data_tools.readers.photos import fault_of
from metapp.appearance.colorimetry import colour_science
from metapp.appearance.latlong import mean_luminance, resample
from metapp.appearance.photograph import photograph
from metapp.learning.task import Task

if TYPE_CHECKING:
    import OpenImageIO as oiio

HEIGHT, WIDTH = 64, 128
SIZE, COUNT = 64, 4  # px and number of the photographs of a map
UNITS = {
    "map": "lat-long radiance, linear Rec.709 [3, 64, 128], rows from the top (+y), the middle column looks to +z; "
    "mean luminance over the sphere 1",
    "scale": "mean luminance of the map before, in the unit of its file",
    "photos": "spheres seen from +z, display values, uint8 0..255 [count, 3, 64, 64], rows from the top; black outside",
}

_SUFFIXES = (".exr", ".hdr", ".rgbe")
_FLOATS = ("half", "float", "double")
_MIN_HEIGHT = 32
_MAX_PIXELS = 2**27  # 16,384 x 8,192 px are 1.6 GB
_NEGATIVE = 1e-3  # of all light: far more than compression and conversions leave around 0
_EXPECTED = "expected an HDR map (.exr or .hdr)"

_UNSTATED = ("", "unknown", "data", "raw")  # say nothing of primaries
_REC709 = "Linear Rec.709 (sRGB)"
_LINEAR = {  # OpenColorIO's name to that of colour-science
    "ACES2065-1": "ACES2065-1",
    "ACEScg": "ACEScg",
    "Linear AdobeRGB": "Adobe RGB (1998)",
    "Linear P3-D65": "P3-D65",
    "Linear Rec.2020": "ITU-R BT.2020",
}
_REC709_XY = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # red, green, blue, white


def is_latlong(height: int, width: int) -> bool:
    """True if a picture is twice as wide as high, but for a row."""
    return abs(width - 2 * height) <= 2


def read_task(path: Path, rows: int = HEIGHT) -> Task:
    """An HDR map as a task of so many rows, as `map_task`, named by the file's stem; errors as of `read_map`."""
    return map_task(path.stem, read_map(path, rows), _draws(path.stem), rows)


def task_of_array(radiance: NDArray[np.float32], name: str, size: int = HEIGHT) -> Task:
    """As `read_task`, of linear Rec.709 radiance float32 [H, 2 H, 3]."""
    _check_shape(name, *radiance.shape[:2])
    light = _light_of([radiance[..., channel] for channel in range(3)], torch.eye(3), name, size)
    return map_task(name, light, _draws(name), size)


def _draws(name: str) -> Rng:
    """The random numbers of a map's photographs, which depend on its name alone."""
    return stream(*hashlib.sha256(name.encode()).digest())


def map_task(name: str, light: Tensor, rng: Rng, rows: int = HEIGHT) -> Task:
    """A map, linear Rec.709 radiance [3, H, W] >= 0, not black, as a task.

    Returns:
        `map` [3, rows, 2 * rows] of mean luminance 1, `scale` [], the mean luminance before, and `photos` uint8
        [4, 3, 64, 64] of spheres under the map, of materials and cameras that `rng` draws.
    """
    light = resample(light.float(), rows, 2 * rows)
    scale = mean_luminance(light)
    light = light / scale
    seeded = torch.Generator().manual_seed(int(rng.integers(2**63)))
    photos = photograph(light.expand(COUNT, -1, -1, -1), seeded, SIZE)
    return Task(name, {"map": light, "scale": scale, "photos": (photos * 255).round().to(torch.uint8)})


def is_map(path: Path) -> bool:
    """True if a file is an HDR image, which holds floating-point values."""
    if path.suffix.lower() in _SUFFIXES:
        return True
    if not opens(path):
        return False
    with opened(path) as source:
        return str(source.spec().format) in _FLOATS


def recognises(path: Path) -> bool:
    """True for an HDR image, and for a folder with one below it."""
    return any(map(is_map, files_of(path)))


def find(paths: Iterable[str | Path]) -> tuple[list[Path], list[str]]:
    """Find HDR maps, as `find_files`; the error of a named file comes when it is read."""

    def fault(file: Path) -> str | None:
        if line := fault_of(file):
            return line
        return "" if is_map(file) else f"{file}: not an HDR map, {_EXPECTED}."

    return find_files(paths, check_exists, fault, f"no map in this folder, {_EXPECTED}; name the folder of the maps.")


def read_map(path: str | Path, height: int = HEIGHT) -> Tensor:
    """A lat-long map, averaged over solid angle: linear Rec.709 radiance, float32 [3, height, 2 * height], >= 0.

    A gray file (Y) gets three equal channels, of several layers the first one in RGB counts, alpha does not. Negative
    values become 0, if together they are less than 0.1 % of the light, and so do colours that Rec.709 cannot hold.

    Raises:
        ValueError: no such file, no image, an LDR one, a damaged one; not 2 : 1 (but for a row), below 32 or over 2^27
            px; channels other than RGB or Y; no linear space; NaN, infinite or negative values; a black map.
    """
    path = Path(path)
    with opened(path) as source:
        spec = source.spec()
    if str(spec.format) not in _FLOATS:
        raise ValueError(
            f"{path}: an LDR image ({spec.format}), {_EXPECTED}; a photograph of a sphere is for fits with --observe "
            "photo."
        )
    _check_shape(path, spec.height, spec.width)
    return _light_of(*_read(path), path, height)


def _check_shape(subject: Path | str, height: int, width: int) -> None:
    found = f"{subject}: {width}x{height} px"
    if not is_latlong(height, width):
        raise ValueError(
            f"{found}, expected a lat-long map, twice as wide as high; a photograph of a sphere should be PNG or JPEG."
        )
    if height < _MIN_HEIGHT or width * height > _MAX_PIXELS:
        raise ValueError(f"{found}, expected {_MIN_HEIGHT} rows or more and {_MAX_PIXELS:,} px or fewer.")


def _light_of(planes: Sequence[NDArray[np.float32]], to_rec709: Tensor, subject: Path | str, height: int) -> Tensor:
    """The planes of red, green and blue of a whole map as `read_map` gives them; `subject` begins errors."""
    _check_values(planes, subject)
    stored = [resample(torch.from_numpy(np.ascontiguousarray(plane)), height, 2 * height) for plane in planes]
    light = torch.einsum("ij,jhw->ihw", to_rec709, torch.stack(stored)).clamp_min(0)
    if not mean_luminance(light) > 0:
        raise ValueError(f"{subject}: black all over, expected a map with some light; leave it out.")
    return light


def _read(path: Path) -> tuple[list[NDArray[np.float32]], Tensor]:
    """The planes of red, green and blue, each [H, W], and the matrix [3, 3] that makes them Rec.709."""
    with opened(path) as source:
        spec = source.spec()
        check_memory(spec, path)
        channels = _channels(spec.channelnames, path)
        first = min(channels)
        values = source.read_image(0, 0, first, max(channels) + 1, "float")
        problem = error_of(source)
        to_rec709 = _to_rec709(spec, path)
    if values is None or problem:
        raise ValueError(
            f"{path}: damaged or incomplete ({reason_of(problem, path)}), expected a whole map; copy or download it "
            "again."
        )
    orientation = spec.get_int_attribute("Orientation", 1)
    upright = turn_upright(values, orientation if orientation <= 4 else 1)  # a map that lies on its side is not 2 : 1
    return [upright[..., channel - first] for channel in channels], to_rec709


def _channels(names: Sequence[str], path: Path) -> list[int]:
    """Indices of red, green and blue: without a layer, else of the first layer that has them; or Y three times."""
    layers: dict[str, dict[str, int]] = {"": {}}
    for index, name in enumerate(names):
        layer, _, channel = name.upper().rpartition(".")
        layers.setdefault(layer, {})[channel] = index
    for found in layers.values():
        if found.keys() >= {"R", "G", "B"}:
            return [found[channel] for channel in "RGB"]
    if layers[""].keys() - {"A"} == {"Y"} and len(layers) == 1:
        return [layers[""]["Y"]] * 3
    shown = ", ".join(name if name.isprintable() else ascii(name) for name in names[:8])
    raise ValueError(f"{path}: channels {shown}, expected R, G, B, or Y alone; export it as RGB.")


def _check_values(planes: Sequence[NDArray[np.float32]], subject: Path | str) -> None:
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


def _to_rec709(spec: oiio.ImageSpec, path: Path) -> Tensor:
    """The matrix [3, 3] from a file's linear colours to Rec.709: by its primaries, else by its space's name."""
    import OpenImageIO as oiio

    primaries = spec.getattribute("chromaticities")
    if primaries is not None:
        return _matrix(primaries, path) if np.abs(np.subtract(primaries, _REC709_XY)).max() > 1e-3 else torch.eye(3)
    stated = spec.get_string_attribute("oiio:ColorSpace")
    space = oiio.ColorConfig("ocio://default").resolve(stated)
    if stated.lower() in _UNSTATED or space == _REC709:
        return torch.eye(3)
    if space not in _LINEAR:
        raise ValueError(
            f"{path}: colours in {stated[:40]!a}, expected a linear space such as Rec.709, Rec.2020 or ACEScg; "
            "export the map with linear colours."
        )
    return _matrix(_LINEAR[space], path)


def _matrix(space: Sequence[float] | str, path: Path) -> Tensor:
    """From a space of colour-science, or xy of red, green, blue and white, to Rec.709, white to white."""
    colour = colour_science()
    if isinstance(space, str):
        source = colour.RGB_COLOURSPACES[space]
    else:
        source = colour.RGB_Colourspace("stated", np.reshape(space[:6], (3, 2)), np.array(space[6:]))
    try:
        matrix = colour.matrix_RGB_to_RGB(source, colour.RGB_COLOURSPACES["ITU-R BT.709"], "Bradford")
    except np.linalg.LinAlgError:
        shown = ", ".join(f"{number:.3g}" for number in source.primaries.flat)
        raise ValueError(
            f"{path}: chromaticities {shown}, expected three primaries that differ; export the map again."
        ) from None
    return torch.from_numpy(matrix).float()
