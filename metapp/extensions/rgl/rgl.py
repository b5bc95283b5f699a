"""Files of the RGL material database (Dupuy and Jakob 2018): read by Mitsuba's `measured` BSDF, and written for it.

They are tensor files, `*_rgb.bsdf` of linear RGB or `*_spec.bsdf` of spectra. Spectra are read as linear RGB, since
Mitsuba evaluates spectra in spectral variants alone. This module knows what fields mean; `tensor_file` knows how they
are stored.

For each angle theta_i of the viewer there is a grid over half vectors m, in u = sqrt(2 theta_m / pi), which is dense at
the normal, and v = phi_m / (2 pi) + 1/2, where phi_m is the azimuth from the viewer's azimuth. The viewers of an
anisotropic material have three azimuths phi_i or more: there phi_m is the azimuth from the tangent, and there is a grid
for each pair of phi_i and theta_i. phi_i goes from -pi to pi, or to 0 or -pi/2 if the material is symmetric. The
database warps grids by the visible normals of a microfacet model; in files written here that warp is the identity
(`vndf` is 1), and Mitsuba samples by `luminance` alone.
"""

from __future__ import annotations

import math
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.brdf_objects import evaluate_mitsuba_bsdf
from data_tools.readers.input_source import ANISOTROPIC_FACT, DAMAGED_FACT, Source, Sources
from data_tools.readers.listing import find_by_suffix, has_suffix
from metapp.appearance.geometry import directions_to_four_angles, directions_to_full_rusinkiewicz
from metapp.application import Facts
from metapp.extensions.rgl.spectra import fields_in_rgb, fields_in_spectra
from metapp.extensions.rgl.tensor_file import TensorFields, read_shapes, read_tensor_file, write_tensor_file
from metapp.learning.task import Task
from metapp.rendering.variant import load_mitsuba
from metapp.storage.files import add_suffix

if TYPE_CHECKING:
    from metapp.apps.brdf.reflectance import Reflectance

# Grids of files written here, of isotropic and of anisotropic materials
VIEWER_ANGLES = 40  # number of angles theta_i of the viewer
HALF_VECTORS_PER_AXIS = 160  # number of half vectors along u, and along v
ANISOTROPIC_VIEWER_AZIMUTHS = 17  # number of azimuths phi_i of the viewer
ANISOTROPIC_VIEWER_ANGLES = 20  # number of angles theta_i of the viewer
ANISOTROPIC_HALF_VECTORS_PER_AXIS = 96  # number of half vectors along u, and along v
LAST_VIEWER_DEGREES = 89.5  # greatest angle theta_i of the viewer
MIN_LUMINANCE_SHARE = 1e-3  # of the mean luminance, added everywhere, so that Mitsuba samples all directions
RGL_SUFFIX = ".bsdf"
SPECTRAL_ENDING = "_spec"  # ending of names of files with spectra, before the suffix
NEGATIVE_DENSITY_SHARE = 1e-6  # of the greatest density: a density that is negative by less is taken for noise
# of the greatest reflectance, by which values may be negative: saturated measured colours lie outside of Rec.709
NEGATIVE_REFLECTANCE_SHARE = 0.1
MAX_FIELD_VALUE = 1e9  # absolute value of any number; measurements are below 1e6
# number of axes of each field that `measured` reads
FIELD_AXES = {
    "description": 1,
    "phi_i": 1,
    "theta_i": 1,
    "sigma": 2,
    "ndf": 2,
    "vndf": 4,
    "luminance": 4,
    "jacobian": 1,
}
COVERED_WAVELENGTHS_NM = (420.0, 680.0)  # the range that spectra must cover
UNITS = brdf_task.UNITS
recognises = partial(has_suffix, suffix=RGL_SUFFIX)


def write_rgl(
    path: str | Path,
    evaluate: Callable[[Tensor], Tensor],
    description: str,
    *,
    azimuths: bool = False,
    spectral: bool = False,
) -> None:
    """Tabulate a BRDF as a file that Mitsuba's `measured` loads; the file is written whole or not at all.

    Args:
        path: the file, of 16 MB, or of 57 MB with spectra; three times as much if the BRDF is anisotropic.
        evaluate: a function of angles (theta_h, theta_d, phi_d) [N, 3] in rad, or with phi_h [N, 4], that returns
            linear RGB [N, 3] in 1/sr.
        description: a text that is kept in the file.
        azimuths: whether the BRDF is anisotropic and takes phi_h.
        spectral: whether the file is for spectral variants, with spectra made by :func:`fields_in_spectra`.

    Raises:
        ValueError: the BRDF has a value that is not finite.
    """
    fraction = np.linspace(1, 0, ANISOTROPIC_VIEWER_ANGLES if azimuths else VIEWER_ANGLES)
    # angles of the viewer from the normal, denser at grazing angles
    theta = math.radians(LAST_VIEWER_DEGREES) * (1 - fraction * fraction)
    phi = np.linspace(-np.pi, np.pi, ANISOTROPIC_VIEWER_AZIMUTHS) if azimuths else np.zeros(1)
    viewers = _directions(torch.from_numpy(theta)[None], torch.from_numpy(phi)[:, None])
    line = torch.linspace(
        0, 1, ANISOTROPIC_HALF_VECTORS_PER_AXIS if azimuths else HALF_VECTORS_PER_AXIS, dtype=torch.float64
    )
    v, u = torch.meshgrid(line, line, indexing="ij")
    half = _directions(u * u * (math.pi / 2), (2 * v - 1) * math.pi)
    to_angles = directions_to_four_angles if azimuths else directions_to_full_rusinkiewicz

    def tabulate(viewer: Tensor) -> NDArray[np.float64]:
        """Return f cos theta_light over half vectors, [3, side, side]; 0 where the light is below the surface."""
        light = 2 * (half @ viewer)[..., None] * half - viewer
        is_visible = (light[..., 2] > 0) & (half @ viewer > 0)
        values = torch.zeros_like(light)
        with torch.no_grad():
            angles = to_angles(light[is_visible], viewer.expand_as(light[is_visible])).float()
            values[is_visible] = evaluate(angles).double() * light[is_visible][:, 2:]
        return values.movedim(-1, 0).numpy()

    tables = np.stack([[tabulate(viewer) for viewer in row] for row in viewers])
    if not np.isfinite(tables).all():
        raise ValueError(f"{path}: values that are NaN or infinite, expected finite reflectance; fit again.")
    # Mitsuba samples cells by luminance, so it is the light that a cell reflects: f cos times the cell's solid angle of
    # lights
    area = 4 * torch.einsum("vuc,ptc->ptvu", half, viewers).clamp_min(0) * (u * (1 - half[..., 2] ** 2).sqrt())
    luminance = tables.mean(2) / np.maximum(np.cos(theta), 1e-3)[:, None, None] * area.numpy()
    luminance += MIN_LUMINANCE_SHARE * luminance.mean((2, 3), keepdims=True) + 1e-12
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
    write_tensor_file(path, fields_in_spectra(fields) if spectral else fields)


def _directions(theta: Tensor, phi: Tensor) -> Tensor:
    """Return unit vectors [..., 3] for angles from the normal and azimuths in rad, whose shapes are broadcast."""
    components = (theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    return torch.stack(torch.broadcast_tensors(*components), -1)


def export(asset: Reflectance, path: Path, provenance: Mapping[str, object], *, spectral: bool = False) -> None:
    """Write reflectance as <path>.bsdf, or as <path>_spec.bsdf for spectral variants of Mitsuba.

    Args:
        asset: the reflectance.
        path: the file, to which the ending is added.
        provenance: not written.
        spectral: whether to write spectra in place of RGB.
    """
    file = path.with_name(f"{path.name}{SPECTRAL_ENDING}{RGL_SUFFIX}") if spectral else add_suffix(path, RGL_SUFFIX)
    description = f"{path.name.removesuffix(RGL_SUFFIX)}: a fit of metapp"
    write_rgl(file, asset.evaluate, description, azimuths=asset.is_anisotropic, spectral=spectral)


export_spectral = partial(export, spectral=True)


def read_task(path: Path, samples: int = 65_536) -> Task:
    """Read an RGL file as a BRDF task that is named by the file's stem; warn of implausible values.

    Args:
        path: the file.
        samples: number of samples of the task.

    Raises:
        ValueError: the file cannot be read, see :func:`read_rgl`.
    """
    return brdf_task.make_measured_task(path.stem, read_rgl(path), samples, path, azimuths=is_anisotropic(path))


def find(path: Path) -> Sources:
    """Find RGL files, and say of each whether its material is anisotropic.

    A damaged file is found all the same; reading it raises an error that says what is wrong.
    """
    files, skipped = find_by_suffix(path, RGL_SUFFIX, "an RGL .bsdf file")
    return [Source(file.stem, file, facts=_read_facts(file)) for file in files], skipped


def _read_facts(file: Path) -> Facts:
    try:
        return {ANISOTROPIC_FACT: is_anisotropic(file)}
    except (ValueError, OSError):
        return {DAMAGED_FACT: True}


def is_anisotropic(path: Path) -> bool:
    """Return whether the material of a file is anisotropic.

    Raises:
        ValueError: the file is damaged.
        OSError: the file cannot be read.
    """
    return math.prod(read_shapes(path).get("phi_i", (0,))) > 2


def read_rgl(path: Path) -> Callable[[Tensor], Tensor]:
    """Read an RGL file as a function, which Mitsuba evaluates.

    Returns:
        A function of angles (theta_h, theta_d, phi_d) [..., 3] in rad, or with phi_h [..., 4] for an anisotropic
        material, that returns linear RGB [..., 3] in 1/sr, >= 0. It raises ValueError if an anisotropic material is
        evaluated without phi_h.

    Raises:
        ValueError: the file is damaged; its spectra do not cover visible light; Mitsuba cannot be loaded.
    """
    fields = read_tensor_file(path)
    check_fields(path, fields)
    mitsuba, anisotropic = load_mitsuba(), fields["phi_i"].size > 2
    with tempfile.TemporaryDirectory() as folder:  # an RGB variant of Mitsuba refuses spectra
        write_tensor_file(Path(folder, path.name), fields_in_rgb(fields))
        bsdf = mitsuba.load_dict({"type": "measured", "filename": str(Path(folder, path.name))})

    def evaluate(angles: Tensor) -> Tensor:
        if anisotropic and angles.shape[-1] != 4:
            raise ValueError(
                f"{path}: anisotropic, expected an isotropic measurement where there is no phi_h, as in MERL tables."
            )
        return evaluate_mitsuba_bsdf(mitsuba, bsdf, angles)

    return evaluate


def check_fields(path: Path, fields: TensorFields) -> None:
    """Refuse a file that Mitsuba would refuse by a long message, or would load though it is damaged.

    Args:
        path: the file, named in messages.
        fields: the arrays of the file.

    Raises:
        ValueError: the first fault of the file, in one line.
    """
    for fault in _find_faults(fields):
        raise ValueError(f"{path}: {fault}; download it again.")
    for name in ("vndf", "luminance"):  # `measured` samples directions by them, and evaluates without them
        if (lowest := float(fields[name].min())) < 0:
            warnings.warn(f"{path}: {name} as low as {lowest:.1g}; values below 0 are taken for noise.", stacklevel=2)


def _find_faults(fields: TensorFields) -> Iterator[str]:
    """Yield the faults of a file, each with what was expected.

    Each check relies on the ones before it: ask for the next fault only if none was found so far.
    """
    colours = "spectra" if "spectra" in fields and "rgb" not in fields else "rgb"
    axes = FIELD_AXES | ({"spectra": 5, "wavelengths": 1} if colours == "spectra" else {"rgb": 5})
    for name, count in axes.items():
        if name not in fields or fields[name].ndim != count:
            found = fields[name].ndim if name in fields else "no"
            yield f"field {name} of {found} axes, expected {count} of an RGL measurement"
        expected_type = "u1" if name in ("description", "jacobian") else "f4"
        if fields[name].dtype != expected_type:
            yield f"{name} of type {fields[name].dtype}, expected {np.dtype(expected_type)}"
        if not (np.abs(fields[name]) < MAX_FIELD_VALUE).all():
            yield f"{name} has NaN, infinite or huge values, expected below {MAX_FIELD_VALUE:g}"
    phis, thetas, side = len(fields["phi_i"]), len(fields["theta_i"]), fields[colours].shape[-1]
    channels = len(fields["wavelengths"]) if colours == "spectra" else 3
    shapes = {"vndf": (phis, thetas, *fields["vndf"].shape[2:]), "luminance": (phis, thetas, side, side),
              colours: (phis, thetas, channels, side, side), "jacobian": (1,)}  # fmt: skip
    for name, shape in shapes.items():
        if fields[name].shape != shape:
            yield f"{name} {fields[name].shape}, expected {shape}"
    if min(thetas, *(min(fields[name].shape[-2:]) for name in ("sigma", "ndf", "vndf", colours))) < 2:
        yield "a grid of one point, expected two or more"
    for name, (low, high) in {"theta_i": (0, math.pi / 2), "phi_i": (-math.pi, math.pi)}.items():
        first, last = float(fields[name].min()), float(fields[name].max())
        if first < low - 1e-3 or last > high + 1e-3:
            yield f"{name} from {first:.4g} to {last:.4g}, expected {low:.4g} to {high:.4g} rad"
    for name in {"theta_i", "phi_i", "wavelengths"} & axes.keys():
        if (np.diff(fields[name]) <= 0).any():
            yield f"{name} not ascending, expected ascending ones"
    lowest, highest = float(fields[colours].min()), float(fields[colours].max())
    if lowest < -NEGATIVE_REFLECTANCE_SHARE * highest or highest <= 0:
        yield f"{colours} from {lowest:.4g} to {highest:.4g}, expected reflectance of 0 or more"
    for name in ("vndf", "luminance"):
        if (
            fields[name].min() < -NEGATIVE_DENSITY_SHARE * fields[name].max()
            or (fields[name].sum((2, 3), dtype=float) <= 0).any()
        ):
            yield f"{name} negative or 0 throughout, expected a density"
    if (fields["sigma"] <= 0).any():
        yield "sigma with values of 0 or less, expected areas above 0"
    if (fields["ndf"] < 0).any():
        yield "ndf with values below 0, expected a distribution"
    if colours == "spectra":
        first, last = fields["wavelengths"][[0, -1]]
        if channels < 4 or first > COVERED_WAVELENGTHS_NM[0] or last < COVERED_WAVELENGTHS_NM[1]:
            found = f"{channels} wavelengths from {first:g} to {last:g} nm"
            expected = f"{COVERED_WAVELENGTHS_NM[0]:g} to {COVERED_WAVELENGTHS_NM[1]:g} nm"
            yield f"{found}, expected 4 or more that cover {expected}, or the _rgb.bsdf"
