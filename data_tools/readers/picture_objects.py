"""Pictures, maps of materials and light in memory as tasks: written as files, which are read like any other.

So sizes, orientations, colours and checks are those of files. Pictures are of PIL, or arrays or tensors [H, W, 3] or
gray [H, W], rows from the top. Integers of 8 or 16 bits are sRGB, floating-point values display values in [0, 1].

Maps of a material are a dictionary by their usual names, such as "diffuse", "normal", "roughness", "specular", each a
picture. Integers are as files hold them: colours sRGB, normals 0..255 for -1..1. Floating-point values are linear, as
`metapp.Fit.maps` has them: colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from data_tools.formats import inputs_of
from data_tools.readers import latlong, material_maps
from data_tools.readers.image_files import Array
from metapp.appearance.latlong import directions
from metapp.learning.task import Task
from metapp.storage.images import write_exr, write_png

if TYPE_CHECKING:
    from PIL import Image as images

SIDE = 512  # px of a picture that a function is evaluated for
ROWS = 512  # of a map of light that a function is evaluated for
FLASH_PX = 2048  # a side of the photograph of maps, at most
LARGEST = 3 * 2**28  # numbers of an array, as of an image file

_EXPECTED = "a path, a picture (of PIL, or an array or tensor [H, W, 3])"
_SLACK = 1e-3  # by which rounding may leave [0, 1]
_UNIT = 0.1  # by which the length of normals, which may be averages, differs from 1 in the mean at most


def texture(source: object, name: str, how: Mapping[str, object]) -> Task:
    """Make the task of a texture.

    Args:
        source: a picture, or f(xy) -> display values in [0, 1], [N, 3] or gray [N], at places xy [N, 2] in [0, 1),
            float32 arrays, x to the right and y down.
        name: of the task.
        how: arguments of readers by name, of which the format's `takes` are used.

    Raises:
        ValueError: neither of these; values of another shape or out of range; as the reader of such a file.
    """
    if callable(source):
        source = rows_of(name, source(texel_places()), SIDE**2).reshape(SIDE, SIDE, -1)
    elif not is_picture(source):
        raise ValueError(f"{name}: {type(source).__name__}, expected {_EXPECTED} or a function f(xy).")
    return _read("texture", name, lambda folder: write_picture(name, source, folder), how)


def flash_photo(source: object, name: str, how: Mapping[str, object]) -> Task:
    """Make the task of a flash photograph, or of one that is rendered of a material, as `material` takes it.

    Raises:
        ValueError: as `material`, and as `data_tools.readers.material_maps.read_task`.
    """

    def write(folder: Path) -> Path:
        path = _write_material(name, source, folder)
        if path.stem == name:
            return path
        photo = material_maps.read_task(path, FLASH_PX, least=1).data["photo"]
        path = folder / f"{name}.png"
        write_png(photo.permute(1, 2, 0) / 255, {"encoding": "sRGB"}, path)
        return path

    return _read("svbrdf_stationary", name, write, how)


def material(source: object, name: str, how: Mapping[str, object]) -> Task:
    """Make the task of a material.

    Args:
        source: maps; or f(xy) -> maps of [N, 3] or [N], at places xy [N, 2] in [0, 1), float32 arrays, x to the right
            and y down; or a picture, the flash photograph of a material.
        name, how: as of `texture`.

    Raises:
        ValueError: none of these; values of another shape or out of range, maps that are missing; as the reader.
    """
    return _read("svbrdf_nonstationary", name, lambda folder: _write_material(name, source, folder), how)


def light(source: object, name: str, how: Mapping[str, object]) -> Task:
    """Make the task of an environment map or of the photograph of a ball.

    Args:
        source: linear Rec.709 radiance, floating point, [H, 2 H, 3] or gray [H, 2 H], lat-long, rows from the top (+y),
            the middle looks to +z; or f(directions) -> radiance [N, 3] or gray [N] of unit vectors [N, 3], float32
            arrays, +y up, +z from the ball to the camera; or the photograph of a ball, a picture.
        name: of the task.
        how: as of `texture`; `observe`, what fits see: "photo" takes floating-point values for a photograph where they
            are not twice as wide as high.

    Raises:
        ValueError: none of these; values of another shape or out of range; as the reader.
    """
    if callable(source):
        places = directions(ROWS, 2 * ROWS).reshape(3, -1).T.contiguous().numpy()
        source = rows_of(name, source(places), len(places)).reshape(ROWS, 2 * ROWS, -1).astype(np.float32)
    elif not is_picture(source):
        raise ValueError(f"{name}: {type(source).__name__}, expected {_EXPECTED} or a function f(directions).")
    is_photo = how.get("observe") == "photo"
    return _read("illumination", name, lambda folder: _write_light(name, source, folder, is_photo), how)


def _read(app: str, name: str, write: Callable[[Path], Path], how: Mapping[str, object]) -> Task:
    """Read the file that `write` makes in a temporary folder; errors name the object alone."""
    with tempfile.TemporaryDirectory(prefix="metapp-") as temporary:
        folder = Path(temporary).resolve()
        path = folder / name
        try:
            path = write(folder)
            forms = inputs_of(app)
            readers = [form for form in forms if form.recognises(path)]
            if not readers:
                raise ValueError(f"{name}: a picture, expected {', '.join(form.inputs for form in forms)}.")
            task: Task = readers[0].read(path, how)
            return task
        except ValueError as error:
            text = str(error).replace(str(path), path.stem)
            raise ValueError(text.replace(f"{folder}/", "")) from None


def _write_light(name: str, source: object, folder: Path, is_photo: bool) -> Path:
    """Write a map as EXR, a photograph as PNG."""
    from PIL.Image import Image

    if isinstance(source, Image):
        return write_picture(name, source, folder)
    values = planes_of(name, source)
    is_map = values.dtype.kind == "f" and latlong.is_latlong(*values.shape[:2])
    if values.dtype.kind != "f" or (is_photo and not is_map):
        return write_picture(name, values, folder)
    if not is_map:
        raise ValueError(
            f"{name}: an array {list(values.shape)}, expected linear radiance [H, 2 H, 3]; the photo of a ball is for "
            "fits with --observe photo."
        )
    with np.errstate(over="ignore"):  # what is infinite is refused as of files
        return _write_linear(values, folder / f"{name}.exr")


def _write_material(name: str, source: object, folder: Path) -> Path:
    """Write maps, of which the path of one is returned, or a photograph."""
    if callable(source):
        maps = source(texel_places())
        if not isinstance(maps, Mapping):
            raise ValueError(f"{name}: returned {type(maps).__name__}, expected a dictionary of maps.")
        source = {
            key: rows_of(f"{name}: {key}", values, SIDE**2).reshape(SIDE, SIDE, -1) for key, values in maps.items()
        }
    if isinstance(source, Mapping):
        return _write_maps(name, source, folder)
    if is_picture(source):
        return write_picture(name, source, folder)
    raise ValueError(
        f"{name}: {type(source).__name__}, expected {_EXPECTED}, maps (a dictionary of such) or a function f(xy)."
    )


def _write_maps(name: str, maps: Mapping[str, object], folder: Path) -> Path:
    roles = {key: material_maps.role_of(str(key)) for key in maps}
    unknown = [key for key, role in roles.items() if role is None]
    if unknown or len(set(filter(None, roles.values()))) < 2:
        found = f"a map {unknown[0]!r}" if unknown else f"maps {', '.join(map(str, maps)) or 'none'}"
        raise ValueError(f"{name}: {found}, expected diffuse, normal, roughness, and, if there is one, specular.")
    used = {key: role for key, role in roles.items() if role}
    files = [_write_map(f"{name}: {key}", maps[key], folder / f"{name}_{key}", role) for key, role in used.items()]
    return files[0]


def _write_map(subject: str, source: object, stem: Path, role: str) -> Path:
    """Write one map as PNG, or, of floating-point values, as EXR."""
    from PIL.Image import Image

    if isinstance(source, Image):
        return write_picture(stem.name, source, stem.parent)
    values = planes_of(subject, source)
    if values.dtype.kind != "f":
        return write_picture(stem.name, values, stem.parent)
    if not role.startswith("normal"):
        check_range(subject, values, "linear values", "scale them to it")
    else:
        check_range(subject, values, "unit vectors", "divide them by their length", -1.0)
        lengths = np.linalg.norm(values, axis=-1)
        if values.shape[-1] != 3 or np.abs(lengths - 1).mean() > _UNIT:
            raise ValueError(
                f"{subject}: vectors of length {lengths.min():.3g} to {lengths.max():.3g}, expected unit vectors "
                "[H, W, 3], x right, y up; of values in [0, 1] take 2 v - 1."
            )
        values, stem = values * 0.5 + 0.5, stem if role != "normal" else stem.with_name(f"{stem.name}_gl")
    return _write_linear(values, stem.with_name(f"{stem.name}.exr"))


def _write_linear(values: Array, path: Path) -> Path:
    write_exr(torch.from_numpy(values.astype(np.float32)), path, half=False)
    return path


def is_picture(source: object) -> bool:
    """True if something is an array, a tensor or a picture of PIL, whatever its shape."""
    from PIL.Image import Image

    return isinstance(source, np.ndarray | Tensor | Image) or hasattr(source, "__array_interface__")


def write_picture(name: str, source: object, folder: Path) -> Path:
    """Write a picture as <folder>/<name>.png; PIL's with EXIF and colour profile.

    Raises:
        ValueError: no picture: another shape or type, values out of range.
    """
    from PIL.Image import Image

    path = folder / f"{name}.png"
    if isinstance(source, Image) and source.mode not in ("I", "F"):
        _write_pil(name, source, path)
        return path
    values = planes_of(name, source)
    if values.dtype.kind == "f":
        check_range(name, values, "display values", "clip them, divide by 255 or give uint8")
    bits = 8 if values.dtype == np.uint8 else 16
    most = 1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    write_png(torch.from_numpy(values / most), {"encoding": "sRGB"}, path, bits)
    return path


def _write_pil(name: str, source: images.Image, path: Path) -> None:
    try:
        if source.mode not in ("L", "LA", "RGB", "RGBA", "I;16"):
            source = source.convert("RGBA" if "transparency" in source.info else "RGB")
        source.save(path, exif=source.getexif() or None, compress_level=1)
    except (OSError, ValueError) as error:  # PIL decodes when it must
        raise ValueError(f"{name}: a picture that PIL cannot decode ({error}), expected a whole one.") from None


def planes_of(name: str, source: object) -> Array:
    """The values of a picture, [H, W, 1 or 3]: uint8, uint16, or float.

    Raises:
        ValueError: another shape or type.
    """
    values = array_of(name, source)
    shape = tuple(values.shape)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or values.shape[2] not in (1, 3) or not values.size:
        remedy = ""
        if values.ndim == 3 and values.shape[2] == 4:
            remedy = "; leave alpha out: a[..., :3]"
        elif values.ndim == 3 and values.shape[0] in (1, 3):
            remedy = "; put the channels last: np.moveaxis(a, 0, -1)"
        raise ValueError(f"{name}: an array {list(shape)}, expected [H, W, 3] or gray [H, W]{remedy}.")
    if values.dtype.kind != "f" and values.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"{name}: values of type {values.dtype}, expected uint8, uint16 or floating point; convert them."
        )
    return values


def check_range(name: str, values: Array, what: str, remedy: str, low: float = 0.0) -> None:
    """Refuse values that are not finite or outside [low, 1].

    Raises:
        ValueError: some are.
    """
    if not np.isfinite(values).all():
        count = np.count_nonzero(~np.isfinite(values))
        raise ValueError(f"{name}: {count:,} values are NaN or infinite, expected finite {what}; replace them.")
    if values.size and not (low - _SLACK <= values.min() and values.max() <= 1 + _SLACK):
        raise ValueError(
            f"{name}: {what} from {values.min():.4g} to {values.max():.4g}, expected {low:g} to 1; {remedy}."
        )


def array_of(name: str, source: object) -> Array:
    """Numbers of any kind, an array, a tensor on any device, nested lists, as a numpy array.

    Halves become float32, long doubles float64, and numbers in another byte order those of the machine.

    Raises:
        ValueError: no numbers, masked ones, too many, or a tensor that is not dense.
    """
    if isinstance(source, np.ma.MaskedArray) and (masked := np.count_nonzero(np.ma.getmaskarray(source))):
        raise ValueError(f"{name}: {masked:,} values are masked, expected all; fill them: a.filled(0).")
    shape = source.shape if isinstance(source, np.ndarray | Tensor) and not getattr(source, "is_nested", False) else ()
    if (count := math.prod(shape)) > LARGEST:
        raise ValueError(f"{name}: {count:,} values, expected {LARGEST:,} or fewer; take a part of them.")
    try:
        values = _of_tensor(source) if isinstance(source, Tensor) else np.asarray(source)
    except Exception:  # whatever an object of another library raises
        values = np.asarray(None)
    if values.dtype.kind not in "uif":
        kind = f"an array of {values.dtype}" if values.ndim else _kind_of(source)
        raise ValueError(f"{name}: {kind}, expected an array of numbers.")
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype == np.longdouble:
        return values.astype(np.float64)
    return values.astype(np.float32) if values.dtype == np.float16 else values


def _of_tensor(tensor: Tensor) -> Array:
    """The numbers of a dense tensor."""
    numbers = tensor.detach().cpu().resolve_neg()
    return (numbers.float() if numbers.dtype == torch.bfloat16 else numbers).numpy()


def _kind_of(source: object) -> str:
    """A type in words; of a tensor what no array can be made of."""
    if not isinstance(source, Tensor):
        return type(source).__name__
    return f"a tensor ({source.dtype}, {source.layout}, on {source.device})".replace("torch.", "")


def texel_places() -> Array:
    """The centres of SIDE x SIDE texels, [SIDE * SIDE, 2] in [0, 1), row by row, float32: x to the right, y down."""
    centres = (np.arange(SIDE, dtype=np.float32) + 0.5) / SIDE
    return np.stack(np.meshgrid(centres, centres), -1).reshape(-1, 2)


def rows_of(name: str, returned: object, count: int) -> Array:
    """Values that a function returned for so many places, [count, 1 or 3].

    Raises:
        ValueError: another shape or type.
    """
    values = array_of(f"{name}'s values", returned)
    if values.shape not in ((count,), (count, 1), (count, 3)):
        raise ValueError(f"{name}: values {list(values.shape)}, expected [{count}, 3]: RGB of each, or gray [{count}].")
    return values.reshape(count, -1)
