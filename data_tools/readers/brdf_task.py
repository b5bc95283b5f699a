"""The samples and pictures of which every BRDF task consists, whatever format the BRDF comes from.

Readers of formats pass a function from angles to reflectance; sample angles are drawn here, and values are checked.
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.input_source import ANISOTROPIC_FACT, SAMPLE_COUNT_FACT
from metapp.appearance.geometry import angle_cosines, is_above_horizon
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.application import Facts
from metapp.learning.task import Task

UNITS = {
    "angles": "rad; theta_h, theta_d, phi_d (Rusinkiewicz), phi_h = 0",
    "phi_h": "rad; azimuth of the half vector from the tangent, of anisotropic materials",
    "reflectance": "1/sr; linear RGB",
    "render": "linear RGB on black, coverage; the reference sphere",
    "environment": "linear RGB on black, coverage; the sphere under the environment map of metapp.appearance.sphere",
}

MIN_AZIMUTH_CHANGE_SHARE = 0.01  # change by phi_h, over the mean, from which on a BRDF is anisotropic
_AZIMUTH_TEST_SAMPLES = 4096  # samples that tell whether a BRDF is anisotropic
_MAX_DRAWS_PER_SAMPLE = 64  # about 2 suffice for a measured table

AnglesToReflectance = Callable[[Tensor], Tensor]  # angles [..., 3 or 4] rad -> reflectance [..., 3] in 1/sr, linear RGB
DrawFilter = Callable[[Tensor], Tensor]  # draws [M, 3] -> indices of those to keep, ascending
# Reflectance in 1/sr times both cosines: a GGX highlight of alpha 0.001 has 8e4; of 138 published files one half has up
# to 4,300, the other up to 2,200. Without the cosines files have up to 1e6 near the horizon, where noise was divided by
# small cosines.
MAX_WEIGHTED_REFLECTANCE_PER_SR = 1e6
MAX_PLAUSIBLE_ALBEDO = (
    2.0  # share of the light from above; of 138 published files one half has up to 1.25, the other up to 1.10
)
_THETA_STEPS, _PHI_STEPS = 256, 16  # directions over which the albedo is summed


def make_brdf_task(
    name: str,
    evaluate: AnglesToReflectance,
    samples: int = 65_536,
    seed: int = 0,
    source: str | Path = "",
    *,
    azimuths: bool = False,
    measured: tuple[Tensor, Tensor] | None = None,
) -> Task:
    """Make the task of one material.

    Samples are drawn uniformly in theta_h, theta_d in [0, pi/2] and phi_d in [0, 2 pi], as Sztrajman et al. 2021
    sample, and stratified (scrambled Sobol); those with light or view below the horizon are dropped. The first half is
    for fits to see, the second half is held out; each half is stratified and in random order, so any prefix is well
    spread.

    Args:
        name: the name of the material.
        evaluate: a function from angles [..., 3 or 4] in rad to reflectance [..., 3] in 1/sr, linear RGB.
        samples: the number of samples N, 2 or more.
        seed: the seed of the samples' angles.
        source: the file that errors name; the material's name if there is none.
        azimuths: whether the material is anisotropic, so that angles have a phi_h, too, which is uniform.
        measured: samples that take the place of drawn ones, angles [N, 3] in rad and reflectance [N, 3] in 1/sr;
            `evaluate` then serves the pictures alone.

    Returns:
        A task with float32 tensors: angles [N, 3] in rad, reflectance [N, 3] in 1/sr, linear RGB, >= 0; pictures of a
        sphere, render [96, 96, 4] in the studio and environment [48, 48, 4], linear RGB and coverage in [0, 1]; for an
        anisotropic material also phi_h [N] in rad.

    Raises:
        ValueError: there are too few samples; reflectance has another shape, or is not finite.
    """
    source = source or name
    if samples < 2:
        raise ValueError(f"{source}: {samples} samples, expected 2 or more.")
    with torch.no_grad():
        if measured is None:
            # cloned, since the angles are cached, and tasks may write to theirs
            angles = _draw_analytic_angles(samples, seed, azimuths).clone()
            reflectance = evaluate(angles).float()
        else:
            angles, reflectance = measured
        if reflectance.shape != (samples, 3):
            raise ValueError(
                f"{source}: reflectance {tuple(reflectance.shape)}, expected {(samples, 3)}: RGB of a sample."
            )
        scenes = {"render": reference_scene(azimuths=azimuths), "environment": environment_scene(azimuths=azimuths)}
        pictures = {key: shade_sphere(scene, evaluate).float() for key, scene in scenes.items()}
    _require_finite(source, (("samples", reflectance), *(("sphere", picture) for picture in pictures.values())))
    return Task(name, {**angle_tensors(angles), "reflectance": reflectance.clamp_min(0), **pictures})


def _require_finite(source: str | Path, subjects: Iterable[tuple[str, Tensor]]) -> None:
    """Raise ValueError for the first of some tensors, by their names, that holds NaN or infinite values."""
    for subject, values in subjects:
        bad_count = int((~torch.isfinite(values)).sum())
        if bad_count:
            raise ValueError(
                f"{source}: {bad_count:,} values of the {subject} are NaN or infinite, expected finite ones; "
                "correct or leave out what they were computed from."
            )


def angle_tensors(angles: Tensor) -> dict[str, Tensor]:
    """Return the tensors by which tasks hold angles, in single precision.

    Args:
        angles: angles in rad, [N, 3 or 4].

    Returns:
        `angles` [N, 3] and, of four angles, `phi_h` [N].
    """
    # Single precision rounds azimuths just below 2 pi up to a number above it; half its last digit there is 2.4e-7.
    angles = wrap_azimuths(angles, 1e-6).float()
    if angles.shape[-1] == 3:
        return {"angles": angles}
    return {"angles": angles[:, :3].contiguous(), "phi_h": angles[:, 3].contiguous()}


def wrap_azimuths(angles: Tensor, step_rad: float) -> Tensor:
    """Set azimuths that are within half a step of a full circle to 0, so that rounding does not lead beyond it.

    Args:
        angles: theta_h, theta_d, phi_d and perhaps phi_h in rad, [N, 3 or 4].
        step_rad: the step to which angles will be rounded.
    """
    thetas, azimuths = angles[:, :2], angles[:, 2:]
    return torch.cat([thetas, torch.where(azimuths > math.tau - step_rad / 2, 0.0, azimuths)], 1)


def facts_of(tensors: Mapping[str, Tensor | None]) -> Facts:
    """Return the facts that the tensors of a task state: whether it is anisotropic, and how many samples fits see.

    Args:
        tensors: tensors by name; None for a tensor of which the name alone is known, as of a data set that is not read.
    """
    facts: dict[str, bool | int] = {ANISOTROPIC_FACT: "phi_h" in tensors}
    if (angles := tensors.get("angles")) is not None:
        first_half, second_half = angles.chunk(2)
        is_repeated = torch.equal(first_half, second_half)  # where no sample is held out, fits see each
        facts[SAMPLE_COUNT_FACT] = len(first_half) if is_repeated else len(angles)
    return facts


def depends_on_phi_h(evaluate: AnglesToReflectance) -> bool:
    """Tell whether reflectance depends on phi_h.

    It does if a random phi_h in place of 0 changes log(1 + f cos theta_i) by more than MIN_AZIMUTH_CHANGE_SHARE of its
    mean.
    """
    angles = _draw_analytic_angles(_AZIMUTH_TEST_SAMPLES, 0, azimuths=True)
    unturned_angles = angles * angles.new_tensor([1.0, 1.0, 1.0, 0.0])
    with torch.no_grad():
        turned_values, unturned_values = (
            torch.log1p(evaluate(samples).clamp_min(0) * angle_cosines(samples).incident[:, None])
            for samples in (angles, unturned_angles)
        )
    return bool((turned_values - unturned_values).abs().mean() > MIN_AZIMUTH_CHANGE_SHARE * unturned_values.mean())


@functools.lru_cache(maxsize=2)
def _draw_analytic_angles(samples: int, seed: int, azimuths: bool = False) -> Tensor:
    """Draw the sample angles [N, 3] in rad of all BRDFs that can be evaluated anywhere; with azimuths [N, 4].

    All of them share one set, which is drawn once.
    """
    return draw_sample_pool(
        "samples", samples, seed, lambda draws: is_above_horizon(draws).nonzero()[:, 0], 3 + azimuths
    )


def draw_sample_pool(source: str | Path, samples: int, seed: int, keep: DrawFilter, axes: int = 3) -> Tensor:
    """Draw angles uniformly until `samples` of them pass a filter, and shuffle each half of these.

    Args:
        source: the file or material that errors name.
        samples: the number of angles to return.
        seed: the seed of the draws and of the order.
        keep: the filter: the indices, ascending, of draws [M, axes] that pass.
        axes: the number of angles: 3, or 4 with phi_h.

    Returns:
        Angles in rad, [samples, axes].

    Raises:
        ValueError: too few of the draws pass.
    """
    extent = torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi, 2 * math.pi])[:axes]
    count = 4 * samples
    while True:
        draws = torch.quasirandom.SobolEngine(axes, scramble=True, seed=seed).draw(count) * extent
        kept_rows = keep(draws)
        if len(kept_rows) >= samples:
            break
        if count > _MAX_DRAWS_PER_SAMPLE * samples:
            found = f"{len(kept_rows):,} valid samples in {count:,} draws"
            raise ValueError(f"{source}: {found}, expected {samples:,}; take fewer samples.")
        count *= 4
    rng = torch.Generator().manual_seed(seed)
    half = samples // 2
    order = torch.cat([torch.randperm(half, generator=rng), half + torch.randperm(samples - half, generator=rng)])
    return draws[kept_rows[:samples][order]]


def make_measured_task(
    name: str,
    evaluate: AnglesToReflectance,
    samples: int,
    source: str | Path,
    *,
    azimuths: bool = False,
    measured: tuple[Tensor, Tensor] | None = None,
) -> Task:
    """Make the task of a material as :func:`make_brdf_task` does, and warn if its values are implausible.

    A warning says that nothing is reflected, that a value is too high, or that more light is reflected than comes in.
    """
    task = make_brdf_task(name, evaluate, samples, source=source, azimuths=azimuths, measured=measured)
    reflectance, cosines = task.data["reflectance"], angle_cosines(task.data["angles"])
    weighted = (reflectance * (cosines.incident * cosines.outgoing)[:, None]).amax(1)
    highest = float(reflectance[weighted.argmax()].max())
    albedo = float(normal_albedo(evaluate, azimuths=azimuths).max())
    if not reflectance.any():
        found, expected = "reflectance 0 everywhere", "some light reflected"
    elif weighted.max() > MAX_WEIGHTED_REFLECTANCE_PER_SR:
        found, expected = (
            f"reflectance of up to {highest:.3g} /sr, not at grazing angles",
            f"at most {MAX_WEIGHTED_REFLECTANCE_PER_SR:g} there",
        )
    elif albedo > MAX_PLAUSIBLE_ALBEDO:
        found, expected = f"{albedo:.3g} times the light that comes in from above is reflected", "at most all of it"
    else:
        return task
    warnings.warn(f"{source}: {found}, expected {expected}; is it damaged, or in another unit?", stacklevel=2)
    return task


def normal_albedo(evaluate: Callable[[Tensor], Tensor], *, azimuths: bool = False) -> Tensor:
    """Return the share of light from straight above that is reflected, linear RGB [3].

    Args:
        evaluate: a function from angles [..., 3 or 4] in rad to reflectance [..., 3] in 1/sr.
        azimuths: whether angles have a phi_h, too, over which the share is averaged.
    """
    # with light from above, the half vector is midway to the viewer: theta_h = theta_d = theta_o / 2
    theta = (torch.arange(_THETA_STEPS) + 0.5) / _THETA_STEPS * (math.pi / 2)
    phi = (torch.arange(_PHI_STEPS) + 0.5) / _PHI_STEPS * math.pi
    half = (theta / 2)[:, None].expand(-1, _PHI_STEPS)
    phi = phi.expand(_THETA_STEPS, -1)
    angles = torch.stack([half, half, phi, 2 * phi] if azimuths else [half, half, phi], -1)
    with torch.no_grad():
        values = evaluate(angles).double().mean(1)
    solid_angle = 2 * math.pi * theta.sin() * (math.pi / 2 / _THETA_STEPS)
    return (values * (solid_angle * theta.cos())[:, None]).sum(0)
