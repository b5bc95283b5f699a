"""Files of the RGL material database (Dupuy and Jakob 2018): read by Mitsuba's `measured` BSDF, and written for it.

Isotropic measurements in RGB, the files `*_rgb.bsdf` of the database: their spectral twins need another variant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.listing import find_by_suffix, has_suffix
from data_tools.readers.plausibility import warn_implausible
from data_tools.readers.rgl_table import write_rgl
from data_tools.readers.tensor_file import read_tensor_file
from metapp.appearance.geometry import rusinkiewicz_to_directions
from metapp.learning.task import Params, Task
from metapp.rendering.variant import load_mitsuba

if TYPE_CHECKING:
    import mitsuba as mi

    from metapp.apps.brdf import Brdf

SUFFIX = ".bsdf"
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
    "rgb": 5,
    "jacobian": 1,
}
UNITS = brdf_task.UNITS

find = partial(find_by_suffix, suffix=SUFFIX, what="an RGL .bsdf file")
recognises = partial(has_suffix, suffix=SUFFIX)


def export(app: Brdf, theta: Params, path: Path) -> None:
    """Write a fitted network of the BRDF application as a file of the RGL database, `path`.bsdf."""
    file = path.with_name(f"{path.name}{SUFFIX}")
    write_rgl(file, partial(app.reflectance, theta), f"{path.name}: a fit of metapp")


def read_task(path: Path, samples: int = 65_536) -> Task:
    """Turn a file into a BRDF task of so many samples, named by the file's stem; warns of implausible values.

    Raises:
        ValueError: as `read_rgl`.
    """
    evaluate = read_rgl(path)
    task = brdf_task.brdf_task(path.stem, evaluate, samples=samples, source=path)
    warn_implausible(path, task, evaluate)
    return task


def read_rgl(path: Path) -> Callable[[Tensor], Tensor]:
    """Read a file.

    Returns:
        Linear RGB [..., 3] in 1/sr, >= 0, of angles (theta_h, theta_d, phi_d) [..., 3] in rad, as Mitsuba evaluates it.

    Raises:
        ValueError: it is damaged, spectral or anisotropic; Mitsuba cannot be loaded.
    """
    check(path, read_tensor_file(path))
    mitsuba = load_mitsuba()
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path.resolve())})
    return partial(_evaluate, mitsuba, bsdf)


def _evaluate(mitsuba: ModuleType, bsdf: mi.BSDF, angles: Tensor) -> Tensor:
    import drjit

    light, viewer = rusinkiewicz_to_directions(angles.reshape(-1, 3).double())
    interaction = drjit.zeros(mitsuba.SurfaceInteraction3f, len(light))
    interaction.wi, outward = (mitsuba.Vector3f(each.T.float().numpy()) for each in (viewer, light))
    value = torch.from_numpy(np.array(bsdf.eval(mitsuba.BSDFContext(), interaction, outward))).T
    return (value / light[:, 2:].clamp_min(1e-6)).clamp_min(0).reshape(angles.shape).to(angles)


def check(path: Path, fields: Mapping[str, NDArray[np.number]]) -> None:
    """Refuse what Mitsuba would refuse at length, or not at all.

    Raises:
        ValueError: one line.
    """
    if "spectra" in fields and "rgb" not in fields:
        raise ValueError(f"{path}: spectral, expected RGB; take the file of that name that ends in _rgb.bsdf.")
    axes = {name: fields[name].ndim for name in AXES if name in fields}
    if axes != AXES:
        wrong = next(name for name in AXES if axes.get(name) != AXES[name])
        raise ValueError(
            f"{path}: field {wrong} of {axes.get(wrong, 'no')} axes, expected {AXES[wrong]}; not an RGL measurement."
        )
    for name in AXES:
        kind = "u1" if name in ("description", "jacobian") else "f4"
        if fields[name].dtype != kind:
            raise ValueError(f"{path}: {name} of type {fields[name].dtype}, expected {np.dtype(kind)}.")
        if kind == "f4" and not (np.abs(fields[name]) < LARGEST).all():
            raise ValueError(f"{path}: {name} has NaN, infinite or huge values, expected below {LARGEST:g}.")
    _check_shapes(path, {name: fields[name].shape for name in AXES})
    _check_values(path, fields)


def _check_shapes(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
    (phis,), (thetas,) = shapes["phi_i"], shapes["theta_i"]
    if phis > 2:
        raise ValueError(f"{path}: anisotropic, {phis} azimuths, expected an isotropic measurement of one or two.")
    side = shapes["rgb"][-1]
    expected = {"vndf": (phis, thetas, *shapes["vndf"][2:]), "luminance": (phis, thetas, side, side),
                "rgb": (phis, thetas, 3, side, side), "jacobian": (1,)}  # fmt: skip
    for name, shape in expected.items():
        if shapes[name] != shape:
            raise ValueError(f"{path}: {name} {shapes[name]}, expected {shape}; download it again.")
    small = [name for name in ("sigma", "ndf", "vndf", "rgb") if min(shapes[name][-2:]) < 2]
    if small or not phis or thetas < 2:
        raise ValueError(f"{path}: a grid of one point or none, expected two or more; download it again.")


def _check_values(path: Path, fields: Mapping[str, NDArray[np.number]]) -> None:
    for name in ("theta_i", "phi_i"):
        if (np.diff(fields[name]) <= 0).any():
            raise ValueError(f"{path}: {name} not ascending, expected ascending angles in rad; download it again.")
    for name in ("vndf", "luminance"):
        slices = fields[name].reshape(-1, *fields[name].shape[2:])
        if (slices < 0).any() or (slices.sum((1, 2), dtype=float) <= 0).any():
            raise ValueError(f"{path}: {name} negative or 0 throughout, expected a density; download it again.")
    if fields["jacobian"][0] and (fields["sigma"] <= 0).any():
        raise ValueError(f"{path}: sigma with values of 0 or less, expected areas above 0; download it again.")
