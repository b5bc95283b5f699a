"""Pictures, maps of materials and light in memory as tasks, as readers make them of decoded files.

Pictures are of PIL, or arrays or tensors [H, W, 3] or gray [H, W], rows from the top. Integers of 8 or 16 bits are
sRGB, floating-point values display values in [0, 1].

Maps of a material are a dictionary by their usual names, such as "diffuse", "normal", "roughness", "specular". Integers
are as files hold them: colours sRGB, normals 0..255 for -1..1. Floating-point values are linear, as `metapp.Fit.maps`
has them: colours and roughness in [0, 1], normals unit vectors, x right, y up, z out of the surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeGuard

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import latlong, material_maps, svbrdf_inputs
from data_tools.readers.colours import LINEAR, SRGB, Array
from data_tools.readers.image_files import Pixels, check_size, pixels_of_pil
from data_tools.readers.photos import SIZE, photo_of
from metapp.appearance.flash import FOV_RAD
from metapp.learning.task import Task
from metapp.registry import inputs_of

if TYPE_CHECKING:
    from PIL.Image import Image

FLASH_PX = 2048  # a side of the photograph of maps, at most
LARGEST = 3 * 2**28  # numbers of an array, as of an image file

_EXPECTED = "a path, a picture (of PIL, or an array or tensor [H, W, 3])"
_SLACK = 1e-3  # by which rounding may leave [0, 1]
_UNIT = 0.1  # by which the length of normals, which may be averages, differs from 1 in the mean at most


def texture(source: object, name: str, *, size: int = SIZE, least: int = 0, **_: object) -> Task:
    """The task of a texture, a picture; arguments and errors as of the reader."""
    return Task(name, {"image": photo_of(_picture(name, source), name, size, least=least)})


def flash_photo(
    source: object, name: str, *, size: int = SIZE, fov_rad: float = 0.0, least: int = 0, **_: object
) -> Task:
    """The task of a flash photograph, or of one that is rendered of a material, as `material` takes it."""
    found = _maps_or_photo(name, source)
    if not isinstance(found, Pixels):
        photo = material_maps.task_of_pixels(found, name, FLASH_PX, least=1).data["photo"]
        found = Pixels(photo.permute(1, 2, 0).numpy(), SRGB, False)
    return Task(name, {"image": photo_of(found, name, size, fov_rad=fov_rad, within_rad=FOV_RAD, least=least)})


def material(
    source: object, name: str, *, size: int = SIZE, fov_rad: float = 0.0, stops: float = 0.0, **_: object
) -> Task:
    """The task of a material, of its maps or of its flash photograph; arguments and errors as of the reader."""
    found = _maps_or_photo(name, source)
    if isinstance(found, Pixels):
        return svbrdf_inputs.photo_task(name, found, name, size, fov_rad, stops)
    return material_maps.task_of_pixels(found, name, size, min(size, SIZE))


def light(
    source: object, name: str, *, rows: int = latlong.HEIGHT, fov_rad: float = 0.0, observe: str = "", **_: object
) -> Task:
    """The task of an environment map or of the photograph of a ball.

    Args:
        source: linear Rec.709 radiance, floating point, lat-long [H, 2 H, 3] or gray [H, 2 H], rows from the top (+y),
            the middle looks to +z; or the photograph of a ball, a picture.
        name: of the task.
        rows, fov_rad: as of the reader.
        observe: "photo" takes floating-point values of another shape for a photograph.

    Raises:
        ValueError: neither; as the reader.
    """
    _check_picture(name, source)
    if isinstance(source, np.ndarray | Tensor):
        values = planes_of(name, source)
        if values.dtype.kind == "f" and latlong.is_latlong(*values.shape[:2]):
            with np.errstate(over="ignore"):  # what is infinite is refused
                return latlong.task_of_array(_rgb(values).astype(np.float32), name, rows)
        if values.dtype.kind == "f" and observe != "photo":
            raise ValueError(
                f"{name}: an array {list(values.shape)}, expected linear radiance [H, 2 H, 3]; the photo of a ball is "
                "for fits with --observe photo."
            )
    forms = inputs_of("illumination").values()
    readers = [files for files in (form.load() for form in forms) if hasattr(files, "task_of_pixels")]
    if not readers:
        raise ValueError(f"{name}: a picture, expected {', '.join(form.inputs for form in forms)}.")
    task: Task = readers[0].task_of_pixels(pixels_of(name, source), name, rows, fov_rad)
    return task


def _check_picture(name: str, source: object, others: str = "") -> None:
    if not is_picture(source):
        raise ValueError(f"{name}: {type(source).__name__}, expected {_EXPECTED}{others}.")


def _picture(name: str, source: object, others: str = "") -> Pixels:
    _check_picture(name, source, others)
    return pixels_of(name, source)


def _maps_or_photo(name: str, source: object) -> Pixels | dict[str, tuple[str, Pixels]]:
    """A photograph, or maps by their names, each with its role."""
    if isinstance(source, Mapping):
        roles = {key: material_maps.role_of(str(key)) for key in source}
        unknown = [key for key, role in roles.items() if role is None]
        if unknown or len(set(filter(None, roles.values()))) < 2:
            found = f"a map {unknown[0]!r}" if unknown else f"maps {', '.join(map(str, source)) or 'none'}"
            raise ValueError(f"{name}: {found}, expected diffuse, normal, roughness, and, if there is one, specular.")
        return {str(key): _map(f"{name}: {key}", source[key], role) for key, role in roles.items() if role}
    return _picture(name, source, " or maps (a dictionary of such)")


def _map(subject: str, source: object, role: str) -> tuple[str, Pixels]:
    """The role of a map and its values, those of floating point linear, normals 0..1 for -1..1."""
    if _is_pil(source) or (values := planes_of(subject, source)).dtype.kind != "f":
        return role, pixels_of(subject, source)
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
        values, role = values * 0.5 + 0.5, "normal (OpenGL)" if role == "normal" else role
    return role, _checked(subject, Pixels(_rgb(values).astype(np.float32), LINEAR, False))


def pixels_of(name: str, source: object) -> Pixels:
    """A picture as readers have that of a file; ValueError for another shape or type, size or range."""
    if _is_pil(source):
        return _checked(name, pixels_of_pil(source, name))
    values = planes_of(name, source)
    if values.dtype.kind == "f":
        check_range(name, values, "display values", "clip them, divide by 255 or give uint8")
        values = (np.clip(values, 0, 1) * 65535 + 0.5).astype(np.uint16)
    return _checked(name, Pixels(_rgb(values), SRGB, False))


def _checked(name: str, pixels: Pixels) -> Pixels:
    height, width = pixels.values.shape[:2]
    check_size(width, height, name)
    return pixels


def _rgb(values: Array) -> Array:
    return np.repeat(values, 3, -1) if values.shape[-1] == 1 else values


def _is_pil(source: object) -> TypeGuard[Image]:
    """True if something is a picture of PIL of 8 bits; others are arrays of their numbers."""
    from PIL.Image import Image

    return isinstance(source, Image) and source.mode not in ("I", "I;16", "F")


def is_picture(source: object) -> bool:
    """True if something is an array, a tensor or a picture of PIL, whatever its shape."""
    from PIL.Image import Image

    return isinstance(source, np.ndarray | Tensor | Image) or hasattr(source, "__array_interface__")


def planes_of(name: str, source: object) -> Array:
    """The values of a picture, [H, W, 1 or 3]: uint8, uint16, or float; ValueError for another shape or type."""
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
    """Refuse values that are not finite or outside [low, 1]."""
    if not np.isfinite(values).all():
        count = np.count_nonzero(~np.isfinite(values))
        raise ValueError(f"{name}: {count:,} values are NaN or infinite, expected finite {what}; replace them.")
    if values.size and not (low - _SLACK <= values.min() and values.max() <= 1 + _SLACK):
        raise ValueError(
            f"{name}: {what} from {values.min():.4g} to {values.max():.4g}, expected {low:g} to 1; {remedy}."
        )


def array_of(name: str, source: object) -> Array:
    """Numbers of any kind, an array, a tensor on any device, nested lists, as a numpy array; halves become float32.

    Raises:
        ValueError: no numbers, masked ones, too many, or a tensor that is not dense.
    """
    if isinstance(source, np.ma.MaskedArray) and (masked := np.count_nonzero(np.ma.getmaskarray(source))):
        raise ValueError(f"{name}: {masked:,} values are masked, expected all; fill them: a.filled(0).")
    try:
        dense = source.detach().cpu().resolve_neg() if isinstance(source, Tensor) else source
        values = np.asarray(dense.float() if isinstance(dense, Tensor) and dense.dtype == torch.bfloat16 else dense)
    except Exception:  # whatever an object of another library raises
        values = np.asarray(None)
    if values.dtype.kind not in "uif":
        kind = f"an array of {values.dtype}" if values.ndim else type(source).__name__
        if isinstance(source, Tensor):
            kind = f"a tensor ({source.dtype}, {source.layout}, on {source.device})".replace("torch.", "")
        raise ValueError(f"{name}: {kind}, expected an array of numbers.")
    if values.size > LARGEST:
        raise ValueError(f"{name}: {values.size:,} values, expected {LARGEST:,} or fewer; take a part of them.")
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    return values.astype(np.float32) if values.dtype == np.float16 else values
