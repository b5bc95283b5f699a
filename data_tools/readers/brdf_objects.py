"""BRDFs in memory as tasks: functions of two directions, arrays of samples, and BSDFs of Mitsuba.

The Python API passes objects here. Files are read elsewhere; tasks of both are made by the same functions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.measured_pairs import MeasuredPairs, find_bad_reflectance, task_of_pairs
from data_tools.readers.numbers import doubles_of, unit_vectors, vectors_of
from data_tools.readers.reciprocity import require_reciprocity
from metapp.appearance.geometry import rusinkiewicz_to_directions
from metapp.learning.task import Task
from metapp.rendering.types import Bsdf
from metapp.rendering.variant import load_mitsuba

FUNCTION_SAMPLES = 65_536  # samples of a BRDF that can be evaluated anywhere
SAMPLE_ARRAY_NAMES = ("wi", "wo", "reflectance")  # the three arrays of measured samples

BrdfFunction = Callable[[np.ndarray, np.ndarray], object]  # wi, wo [N, 3] -> reflectance [N, 3] or [N] in 1/sr


def task_of_object(source: object, name: str, **_: object) -> Task:
    """Make the task of a BRDF in memory, with phi_h if the BRDF is anisotropic.

    Args:
        source: one of three. A function f(wi, wo) that returns the reflectance in 1/sr without the cosine, linear RGB
            [N, 3] or gray [N], for float32 unit vectors [N, 3] to light and viewer (z is the normal). Or arrays
            (wi, wo, reflectance), each [N, 3], of measured samples; see :func:`task_of_pairs`. Or a BSDF of Mitsuba in
            an RGB variant that is not scalar.
        name: the name of the task.

    Raises:
        ValueError: the source is none of these; its values are of another shape, negative, or not finite; there are too
            few samples.
    """
    if isinstance(source, tuple | list):
        if len(source) != len(SAMPLE_ARRAY_NAMES):
            raise ValueError(
                f"{name}: {len(source)} arrays, expected {len(SAMPLE_ARRAY_NAMES)}: {', '.join(SAMPLE_ARRAY_NAMES)}; "
                "give one of each."
            )
        wi, wo = (unit_vectors(name, *pair) for pair in zip(source[:2], SAMPLE_ARRAY_NAMES[:2], strict=True))
        values = vectors_of(name, source[2], SAMPLE_ARRAY_NAMES[2])
        if bad_value := find_bad_reflectance(name, values.numpy()):
            row, column, expected = bad_value
            raise ValueError(f"{name}: reflectance {float(values[row, column]):.6g} in row {row}, expected {expected}.")
        if not len(wi) == len(wo) == len(values):
            found = f"{len(wi)} rows of wi, {len(wo)} of wo, {len(values)} of reflectance"
            raise ValueError(f"{name}: {found}, expected equally many; give one of each for a sample.")
        pairs = MeasuredPairs(wi, wo, values.clamp_min(0)).above(name)
        require_reciprocity(name, pairs)
        return task_of_pairs(name, pairs)
    if type(source).__module__.partition(".")[0] == "mitsuba":
        return _make_function_task(name, partial(evaluate_mitsuba_bsdf, load_mitsuba(), source))
    if callable(source):
        return _make_function_task(name, partial(_call_function, name, source))
    raise ValueError(
        f"{name}: {type(source).__name__}, expected a path, a function f(wi, wo), arrays (wi, wo, reflectance) or a "
        "BSDF of Mitsuba."
    )


def _make_function_task(name: str, evaluate: brdf_task.AnglesToReflectance) -> Task:
    """Make the task of a BRDF that can be evaluated at any angles."""
    return brdf_task.make_measured_task(
        name, evaluate, FUNCTION_SAMPLES, name, azimuths=brdf_task.depends_on_phi_h(evaluate)
    )


def evaluate_mitsuba_bsdf(mitsuba: ModuleType, bsdf: Bsdf, angles: Tensor) -> Tensor:
    """Evaluate a BSDF of Mitsuba without the cosine.

    Args:
        mitsuba: the module, with its variant set.
        bsdf: the BSDF.
        angles: Rusinkiewicz angles in rad, [..., 3], or [..., 4] with phi_h.

    Returns:
        Linear RGB [..., 3] in 1/sr, >= 0.
    """
    import drjit

    light, viewer = rusinkiewicz_to_directions(angles.reshape(-1, angles.shape[-1]).double())
    interaction = drjit.zeros(mitsuba.SurfaceInteraction3f, len(light))
    interaction.wi = mitsuba.Vector3f(viewer.T.float().numpy())
    outward = mitsuba.Vector3f(light.T.float().numpy())
    value = torch.from_numpy(np.array(bsdf.eval(mitsuba.BSDFContext(), interaction, outward))).T
    return (value / light[:, 2:].clamp_min(1e-6)).clamp_min(0).reshape(*angles.shape[:-1], 3).to(angles)


def _call_function(name: str, function: BrdfFunction, angles: Tensor) -> Tensor:
    """Evaluate a user's function at Rusinkiewicz angles [..., 3 or 4] in rad; return linear RGB [..., 3] in 1/sr.

    Raises:
        ValueError: the function returns another shape or negative values.
    """
    wi, wo = (direction.reshape(-1, 3).float().numpy() for direction in rusinkiewicz_to_directions(angles.double()))
    values = doubles_of(f"{name}'s values", function(wi, wo)).to(angles)
    if values.shape == (len(wi),):
        values = values[:, None].expand(-1, 3)
    if values.shape != (len(wi), 3):
        found = f"the function returns values {tuple(values.shape)}"
        raise ValueError(f"{name}: {found}, expected {(len(wi), 3)}, the RGB of each pair of directions; reshape them.")
    if (values < 0).any():
        least = float(values.min())
        raise ValueError(f"{name}: reflectance of {least:.3g} /sr, expected 0 or more; clamp it in the function.")
    return values.reshape(*angles.shape[:-1], 3)
