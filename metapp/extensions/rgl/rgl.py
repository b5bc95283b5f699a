"""Files of the RGL material database (Dupuy and Jakob 2018): read by Mitsuba's `measured` BSDF, and written for it.

They are tensor files, `*_rgb.bsdf` of linear RGB or `*_spec.bsdf` of spectra, which become linear RGB: Mitsuba's own
spectra need another variant.

For each angle of the viewer there is a grid over half vectors m, in u = sqrt(2 theta_m / pi), which is dense at the
normal, and v = phi_m / (2 pi) + 1/2, the azimuth to the viewer's. Of an anisotropic material, whose viewers have
three azimuths phi_i or more, phi_m is from the tangent, and there is a grid for each pair of phi_i and theta_i; phi_i
goes from -pi to pi, or to 0 or -pi/2 of a material that is symmetric. The database warps grids by the visible normals
of a microfacet model; in files written here that warp is the identity (`vndf` is 1), and `luminance` alone says how
Mitsuba samples.
"""

from __future__ import annotations

import math
import tempfile
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.brdf_objects import evaluated_by
from data_tools.readers.listing import any_passes, find_by_suffix, has_suffix
from metapp.appearance.geometry import (
    directions_to_four_angles,
    directions_to_full_circle,
)
from metapp.extensions.rgl.spectra import check_wavelengths, in_rgb, in_spectra, is_spectral
from metapp.extensions.rgl.tensor_file import read_tensor_file, write_tensor_file
from metapp.learning.task import Params, Task
from metapp.rendering.variant import load_mitsuba
from metapp.storage.files import suffixed

if TYPE_CHECKING:
    from metapp.apps.brdf.app import Brdf

NODES = 40  # angles of the viewer
GRID = 160  # half vectors along u and v
TURNS, FEWER_NODES, FEWER = 17, 20, 96  # azimuths of the viewer, angles and half vectors of an anisotropic material
LAST_DEGREES = 89.5
LEAST_LUMINANCE = 1e-3  # of the mean: where a value is 0, directions are drawn all the same
SUFFIX = ".bsdf"
COLOURS, SPECTRAL = "_rgb", "_spec"  # ends of the database's names, before the suffix
BELOW_ZERO = 1e-6  # of the greatest value of a density: values that little below 0 are noise
BELOW_BLACK = 0.1  # of the greatest reflectance: saturated colours of measurements, outside of Rec.709, have so much
LARGEST = 1e9  # of any number; measurements are below 1e6
# number of axes of each field that `measured` reads
AXES = {
    "description": 1,
    "phi_i": 1,
    "theta_i": 1,
    "sigma": 2,
    "ndf": 2,
    "vndf": 4,
    "luminance": 4,
    "jacobian": 1,
}
RGB_AXES, SPECTRAL_AXES = {"rgb": 5}, {"wavelengths": 1, "spectra": 5}
UNITS = brdf_task.UNITS
find = partial(find_by_suffix, suffix=SUFFIX, what="an RGL .bsdf file")
recognises = partial(has_suffix, suffix=SUFFIX)


def viewer_angles(count: int = NODES) -> NDArray[np.float64]:
    """Angles of the viewer in rad, [count], from the normal to LAST_DEGREES and denser there."""
    rest = 1 - np.linspace(0, 1, count)
    angles: NDArray[np.float64] = math.radians(LAST_DEGREES) * (1 - rest * rest)
    return angles


def half_vectors(side: int = GRID) -> Tensor:
    """The grid's half vectors, [side (v), side (u), 3]."""
    line = torch.linspace(0, 1, side, dtype=torch.float64)
    v, u = torch.meshgrid(line, line, indexing="ij")
    theta, phi = u * u * (math.pi / 2), (2 * v - 1) * math.pi
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)


def write_rgl(
    path: str | Path,
    evaluate: Callable[[Tensor], Tensor],
    description: str,
    *,
    azimuths: bool = False,
    spectral: bool = False,
) -> None:
    """Tabulate a BRDF as a file that `measured` loads in RGB variants, or in spectral ones; whole or not at all.

    Args:
        path: the file, 16 MB, or 57 MB of spectra; three times as much of an anisotropic BRDF.
        evaluate: linear RGB [N, 3] in 1/sr, of angles (theta_h, theta_d, phi_d) [N, 3] in rad, or with phi_h [N, 4].
        description: kept in the file.
        azimuths: whether the BRDF is anisotropic and takes phi_h.
        spectral: whether it is for spectral variants, with spectra as of `in_spectra`.

    Raises:
        ValueError: a value that is not finite.
    """
    half, theta = (half_vectors(FEWER), viewer_angles(FEWER_NODES)) if azimuths else (half_vectors(), viewer_angles())
    phi = np.linspace(-np.pi, np.pi, TURNS) if azimuths else np.zeros(1)
    viewers = torch.from_numpy(_directions(theta[None], phi[:, None]))
    to_angles = directions_to_four_angles if azimuths else directions_to_full_circle
    tables = np.stack([[_table(evaluate, to_angles, half, viewer) for viewer in row] for row in viewers])
    if not np.isfinite(tables).all():
        raise ValueError(f"{path}: values that are NaN or infinite, expected finite reflectance; fit again.")
    # densities per area of the grid, so that what counts is the light a cell reflects
    luminance = tables.mean(2) / np.maximum(np.cos(theta), 1e-3)[:, None, None] * _area(half, viewers)
    luminance += LEAST_LUMINANCE * luminance.mean((2, 3), keepdims=True) + 1e-12
    fields: dict[str, NDArray[np.number]] = {
        "description": np.frombuffer(description.encode() or b" ", np.uint8),
        "phi_i": phi.astype(np.float32),
        "theta_i": theta.astype(np.float32),
        "sigma": np.ones((2, 2), np.float32),
        "ndf": np.ones((2, 2), np.float32),
        "vndf": np.ones((*viewers.shape[:2], 2, 2), np.float32),
        "luminance": luminance.astype(np.float32),
        "rgb": tables.astype(np.float32),
        "jacobian": np.zeros(1, np.uint8),
    }
    write_tensor_file(path, in_spectra(fields) if spectral else fields)


def _directions(theta: NDArray[np.float64], phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors [..., 3] of angles that broadcast."""
    parts = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    return np.stack(np.broadcast_arrays(*parts), -1)


def _table(
    evaluate: Callable[[Tensor], Tensor],
    to_angles: Callable[[Tensor, Tensor], Tensor],
    half: Tensor,
    viewer: Tensor,
) -> NDArray[np.float64]:
    """f cos theta of the light, [3, side, side], of one viewer [3]; 0 where the light is below the surface."""
    light = 2 * (half @ viewer)[..., None] * half - viewer
    up = (light[..., 2] > 0) & (half @ viewer > 0)
    pairs = to_angles(light[up], viewer.expand_as(light[up]))
    values = torch.zeros_like(light)
    with torch.no_grad():
        values[up] = evaluate(pairs.float()).double() * light[up][:, 2:]
    return values.movedim(-1, 0).numpy()


def _area(half: Tensor, viewers: Tensor) -> NDArray[np.float64]:
    """Solid angle of lights over area of the grid, but for factors that rows share, [P, T, side, side]."""
    line = torch.linspace(0, 1, half.shape[1], dtype=torch.float64)
    jacobian = line * (1 - half[..., 2] ** 2).sqrt()
    cosine = torch.einsum("vuc,ptc->ptvu", half, viewers).clamp_min(0)
    return (4 * cosine * jacobian).numpy()


def export(app: Brdf, theta: Params, path: Path) -> None:
    """Write a fitted network of the BRDF application as a file of the RGL database; `path` without .bsdf gets it."""
    write_fit(app, theta, suffixed(path, SUFFIX), path.name)


def export_spectral(app: Brdf, theta: Params, path: Path) -> None:
    """Write a fitted network as <path>_spec.bsdf, for spectral variants of Mitsuba."""
    write_fit(app, theta, path.with_name(f"{path.name}{SPECTRAL}{SUFFIX}"), path.name, spectral=True)


def write_fit(app: Brdf, theta: Params, file: Path, name: str, *, spectral: bool = False) -> None:
    """Write a fitted network as `write_rgl`, with its name in the description."""
    evaluate, anisotropic = partial(app.reflectance, theta), app.setup.anisotropic
    write_rgl(file, evaluate, f"{name}: a fit of metapp", azimuths=anisotropic, spectral=spectral)


def read_task(path: Path, samples: int = 65_536) -> Task:
    """Turn a file into a BRDF task of so many samples, named by the file's stem; warns of implausible values.

    Raises:
        ValueError: as `read_rgl`.
    """
    return brdf_task.measured_task(path.stem, read_rgl(path), samples, path, azimuths=is_anisotropic(path))


def is_anisotropic(path: Path) -> bool:
    """Test whether a file, or one of a folder, is of an anisotropic material; of damaged ones nothing is said."""
    return any_passes(path, SUFFIX, lambda file: read_tensor_file(file).get("phi_i", np.zeros(0)).size > 2)


def read_rgl(path: Path) -> Callable[[Tensor], Tensor]:
    """Read a file.

    Returns:
        Linear RGB [..., 3] in 1/sr, >= 0, of angles (theta_h, theta_d, phi_d) [..., 3] in rad, and phi_h of an
        anisotropic material, as Mitsuba evaluates it; ValueError where that is missing.

    Raises:
        ValueError: it is damaged; its spectra do not cover visible light; Mitsuba cannot be loaded.
    """
    fields = read_tensor_file(path)
    check(path, fields)
    mitsuba = load_mitsuba()
    if SPECTRAL_AXES.keys() & fields.keys():  # which an RGB variant of Mitsuba refuses, also beside `rgb`
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, path.name)
            write_tensor_file(file, in_rgb(fields))
            bsdf = mitsuba.load_dict({"type": "measured", "filename": str(file)})
    else:
        bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path.resolve())})
    if fields["phi_i"].size <= 2:
        return partial(evaluated_by, mitsuba, bsdf)

    def of_four(angles: Tensor) -> Tensor:
        if angles.shape[-1] != 4:
            raise ValueError(
                f"{path}: anisotropic, expected an isotropic measurement where there is no phi_h, as in MERL tables."
            )
        return evaluated_by(mitsuba, bsdf, angles)

    return of_four


def check(path: Path, fields: Mapping[str, NDArray[np.number]]) -> None:
    """Refuse what Mitsuba would refuse at length, or not at all.

    Raises:
        ValueError: one line.
    """
    wanted = AXES | (SPECTRAL_AXES if is_spectral(fields) else RGB_AXES)
    axes = {name: fields[name].ndim for name in wanted if name in fields}
    if axes != wanted:
        wrong = next(name for name in wanted if axes.get(name) != wanted[name])
        raise ValueError(
            f"{path}: field {wrong} of {axes.get(wrong, 'no')} axes, expected {wanted[wrong]}; not an RGL measurement."
        )
    for name in wanted:
        kind = "u1" if name in ("description", "jacobian") else "f4"
        if fields[name].dtype != kind:
            raise ValueError(f"{path}: {name} of type {fields[name].dtype}, expected {np.dtype(kind)}.")
        if kind == "f4" and not (np.abs(fields[name]) < LARGEST).all():
            raise ValueError(f"{path}: {name} has NaN, infinite or huge values, expected below {LARGEST:g}.")
    _check_shapes(path, {name: fields[name].shape for name in wanted})
    _check_values(path, fields)
    if is_spectral(fields):
        check_wavelengths(path, fields["wavelengths"])


def _check_shapes(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
    (phis,), (thetas,) = shapes["phi_i"], shapes["theta_i"]
    colours, count = ("spectra", shapes["wavelengths"][0]) if "spectra" in shapes else ("rgb", 3)
    side = shapes[colours][-1]
    expected = {"vndf": (phis, thetas, *shapes["vndf"][2:]), "luminance": (phis, thetas, side, side),
                colours: (phis, thetas, count, side, side), "jacobian": (1,)}  # fmt: skip
    for name, shape in expected.items():
        if shapes[name] != shape:
            raise ValueError(f"{path}: {name} {shapes[name]}, expected {shape}; download it again.")
    small = [name for name in ("sigma", "ndf", "vndf", colours) if min(shapes[name][-2:]) < 2]
    if small or not phis or thetas < 2:
        raise ValueError(f"{path}: a grid of one point or none, expected two or more; download it again.")


def _check_values(path: Path, fields: Mapping[str, NDArray[np.number]]) -> None:
    for name, low, high in (("theta_i", 0.0, math.pi / 2), ("phi_i", -math.pi, math.pi)):
        angles = fields[name]
        if angles.min() < low - 1e-3 or angles.max() > high + 1e-3:
            raise ValueError(
                f"{path}: {name} from {angles.min():.4g} to {angles.max():.4g}, expected {low:.4g} to {high:.4g} rad; "
                "download it again."
            )
        if (np.diff(angles) <= 0).any():
            raise ValueError(f"{path}: {name} not ascending, expected ascending angles in rad; download it again.")
    colours = "spectra" if is_spectral(fields) else "rgb"
    least, most = float(fields[colours].min()), float(fields[colours].max())
    if least < -BELOW_BLACK * most or most <= 0:
        raise ValueError(
            f"{path}: {colours} from {least:.4g} to {most:.4g}, expected reflectance of 0 or more; download it again."
        )
    for name in ("vndf", "luminance"):
        slices = fields[name].reshape(-1, *fields[name].shape[2:])
        least, most = float(slices.min()), float(slices.max())
        if least < -BELOW_ZERO * most or (slices.sum((1, 2), dtype=float) <= 0).any():
            raise ValueError(f"{path}: {name} negative or 0 throughout, expected a density; download it again.")
        if least < 0:  # noise of a genuine measurement; `measured` draws directions by it, and `eval` does not use it
            warnings.warn(f"{path}: {name} of down to {least:.1g}, taken for noise below 0.", stacklevel=2)
    if (fields["sigma"] <= 0).any():
        raise ValueError(f"{path}: sigma with values of 0 or less, expected areas above 0; download it again.")
    if (fields["ndf"] < 0).any():
        raise ValueError(f"{path}: ndf with values below 0, expected a distribution; download it again.")
