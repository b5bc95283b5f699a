"""The samples that every BRDF task is made of, whatever the BRDF comes from: drawn and checked."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.input_source import ANISOTROPIC_FACT, SAMPLE_COUNT_FACT, Facts
from metapp.appearance.geometry import angle_cosines, is_above_horizon
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.learning.task import Task

UNITS = {
    "angles": "rad; theta_h, theta_d, phi_d (Rusinkiewicz), phi_h = 0",
    "phi_h": "rad; azimuth of the half vector from the tangent, of anisotropic materials",
    "reflectance": "1/sr; linear RGB",
    "render": "linear RGB on black, coverage; the reference sphere",
    "environment": "linear RGB on black, coverage; the sphere under the environment map of metapp.appearance.sphere",
}

MIN_AZIMUTH_CHANGE_SHARE = 0.01
_TRIED = 4096  # samples
_MAX_DRAWS = 64  # per sample; about 2 suffice for a measured table

AnglesToReflectance = Callable[[Tensor], Tensor]  # angles [..., 3 or 4] rad -> reflectance [..., 3] in 1/sr, linear RGB
DrawFilter = Callable[[Tensor], Tensor]  # draws [M, 3] -> indices of those to keep, ascending
# 1/sr, times both cosines: a GGX highlight of alpha 0.001 has 8e4. Of 138 published files half have up to 4,300, the
# others 2,200; without the cosines, up to 1e6 beside the horizon, where a division by them lets noise grow
MAX_WEIGHTED_REFLECTANCE_PER_SR = 1e6
MAX_PLAUSIBLE_ALBEDO = 2.0  # of the light that comes in; of 138 published files half have up to 1.25, the others 1.10
_RINGS, _TURNS = 256, 16


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

    Samples are draws uniform in theta_h, theta_d in [0, pi/2] and phi_d in [0, 2 pi] (as Sztrajman et al. 2021 sample),
    kept where light and view are above the horizon, stratified (scrambled Sobol). The first half is for fits to see,
    the second half held out; each half is stratified and in random order, so any prefix is well spread.

    Args:
        name: of the material.
        evaluate: reflectance [..., 3] in 1/sr, linear RGB, of angles [..., 3 or 4] in rad.
        samples: N, 2 or more.
        seed: of the draws.
        source: the file that errors name; the material's name if there is none.
        azimuths: whether the material is anisotropic and takes phi_h, too, which is uniform.
        measured: samples in place of draws, angles [N, 3] and reflectance [N, 3]; pictures alone are evaluated.

    Returns:
        A task with angles [N, 3] rad, reflectance [N, 3] in 1/sr, linear RGB, >= 0, and of the sphere render
        [96, 96, 4] in the studio and environment [48, 48, 4], linear RGB and coverage in [0, 1]; of an anisotropic one
        phi_h [N] rad; all float32.

    Raises:
        ValueError: too few samples; reflectance of another shape, or not finite.
    """
    source = source or name
    if samples < 2:
        raise ValueError(f"{source}: {samples} samples, expected 2 or more.")
    with torch.no_grad():
        if measured is None:
            angles = _analytic_angles(samples, seed, azimuths).clone()  # tasks must not share what they may write to
            reflectance = evaluate(angles).float()
        else:
            angles, reflectance = measured
        if reflectance.shape != (samples, 3):
            raise ValueError(
                f"{source}: reflectance {tuple(reflectance.shape)}, expected {(samples, 3)}: RGB of a sample."
            )
        spheres = {"render": reference_scene(azimuths=azimuths), "environment": environment_scene(azimuths=azimuths)}
        pictures = {key: shade_sphere(scene, evaluate).float() for key, scene in spheres.items()}
    _require_finite(source, (("samples", reflectance), *(("sphere", picture) for picture in pictures.values())))
    return Task(name, {**angle_tensors(angles), "reflectance": reflectance.clamp_min(0), **pictures})


def _require_finite(source: str | Path, subjects: Iterable[tuple[str, Tensor]]) -> None:
    for subject, values in subjects:
        bad = int((~torch.isfinite(values)).sum())
        if bad:
            raise ValueError(f"{source}: {bad:,} values of the {subject} are NaN or infinite, expected finite ones.")


def angle_tensors(angles: Tensor) -> dict[str, Tensor]:
    """The tensors of a task for angles [N, 3 or 4]: `angles` [N, 3] and, of four, `phi_h` [N]."""
    if angles.shape[-1] == 3:
        return {"angles": angles}
    return {"angles": angles[:, :3].contiguous(), "phi_h": angles[:, 3].contiguous()}


def facts_of(tensors: Mapping[str, Tensor | None]) -> Facts:
    """Return what tensors of a task tell; values are None where names alone are known, as of data sets."""
    facts: dict[str, bool | int] = {ANISOTROPIC_FACT: "phi_h" in tensors}
    if (angles := tensors.get("angles")) is not None:
        first, second = angles.chunk(2)
        facts[SAMPLE_COUNT_FACT] = (
            len(first) if torch.equal(first, second) else len(angles)
        )  # none held out, or half of them
    return facts


def depends_on_phi_h(evaluate: AnglesToReflectance) -> bool:
    """True if reflectance depends on phi_h: by more than LEAST_CHANGE of its mean, both as log(1 + f cos theta_i)."""
    angles = _analytic_angles(_TRIED, 0, azimuths=True)
    still = angles * angles.new_tensor([1.0, 1.0, 1.0, 0.0])
    with torch.no_grad():
        turned, first = (torch.log1p(evaluate(each).clamp_min(0) * angle_cosines(each).incident[:, None])
                         for each in (angles, still))  # fmt: skip
    return bool((turned - first).abs().mean() > MIN_AZIMUTH_CHANGE_SHARE * first.mean())


@functools.lru_cache(maxsize=2)
def _analytic_angles(samples: int, seed: int, azimuths: bool = False) -> Tensor:
    """The pool [N, 3] rad of all materials that can be evaluated anywhere; [N, 4] with phi_h."""
    return draw_sample_pool(
        "samples", samples, seed, lambda draws: is_above_horizon(draws).nonzero()[:, 0], 3 + azimuths
    )


def draw_sample_pool(source: str | Path, samples: int, seed: int, keep: DrawFilter, axes: int = 3) -> Tensor:
    """The first `samples` draws [N, axes] rad that are kept, the order random within each half."""
    extent = torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi, 2 * math.pi])[:axes]
    count = 4 * samples
    while True:
        draws = torch.quasirandom.SobolEngine(axes, scramble=True, seed=seed).draw(count) * extent
        kept = keep(draws)
        if len(kept) >= samples:
            break
        if count > _MAX_DRAWS * samples:
            raise ValueError(
                f"{source}: {len(kept):,} valid samples in {count:,} draws, expected {samples:,}; take fewer samples."
            )
        count *= 4
    rng = torch.Generator().manual_seed(seed)
    half = samples // 2
    order = torch.cat([torch.randperm(half, generator=rng), half + torch.randperm(samples - half, generator=rng)])
    return draws[kept[:samples][order]]


def make_measured_task(
    name: str,
    evaluate: AnglesToReflectance,
    samples: int,
    source: str | Path,
    *,
    azimuths: bool = False,
    measured: tuple[Tensor, Tensor] | None = None,
) -> Task:
    """As `make_brdf_task`, of a file; warns if nothing is reflected, far too much, or more than comes in."""
    task = make_brdf_task(name, evaluate, samples, source=source, azimuths=azimuths, measured=measured)
    reflectance, cos = task.data["reflectance"], angle_cosines(task.data["angles"])
    weighted = (reflectance * (cos.incident * cos.outgoing)[:, None]).amax(1)
    high = float(reflectance[weighted.argmax()].max())
    albedo = float(normal_albedo(evaluate, azimuths=azimuths).max())
    if not reflectance.any():
        found, expected = "reflectance 0 everywhere", "some light reflected"
    elif weighted.max() > MAX_WEIGHTED_REFLECTANCE_PER_SR:
        found, expected = (
            f"reflectance of up to {high:.3g} /sr, not at grazing angles",
            f"at most {MAX_WEIGHTED_REFLECTANCE_PER_SR:g} there",
        )
    elif albedo > MAX_PLAUSIBLE_ALBEDO:
        found, expected = f"{albedo:.3g} times the light that comes in from above is reflected", "at most all of it"
    else:
        return task
    warnings.warn(f"{source}: {found}, expected {expected}; is it damaged, or in another unit?", stacklevel=2)
    return task


def normal_albedo(evaluate: Callable[[Tensor], Tensor], *, azimuths: bool = False) -> Tensor:
    """The share of light from straight above that is reflected, linear RGB [3]; with azimuths, the mean over phi_h."""
    # the half vector is in the middle: theta_h = theta_d = theta_o / 2
    theta = (torch.arange(_RINGS) + 0.5) / _RINGS * (math.pi / 2)
    phi = (torch.arange(_TURNS) + 0.5) / _TURNS * math.pi
    half = (theta / 2)[:, None].expand(-1, _TURNS)
    phi = phi.expand(_RINGS, -1)
    angles = torch.stack([half, half, phi, 2 * phi] if azimuths else [half, half, phi], -1)
    with torch.no_grad():
        values = evaluate(angles).double().mean(1)
    solid_angle = 2 * math.pi * theta.sin() * (math.pi / 2 / _RINGS)
    return (values * (solid_angle * theta.cos())[:, None]).sum(0)
