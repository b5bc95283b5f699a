"""Helpers for tests of Mitsuba BSDFs: random directions, interactions, and Mitsuba's chi-square test of sampling."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def random_directions(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Return random unit vectors above the surface, [3, count]."""
    vectors = np.random.default_rng(seed).standard_normal((3, count))
    vectors[2] = abs(vectors[2])
    return (vectors / np.linalg.norm(vectors, axis=0)).astype(np.float32)


def mirrored_pairs(count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return directions to lights and viewers, [3, count] each; half of the lights are near the mirror direction."""
    light, viewer = random_directions(count, 1), random_directions(count, 2)
    near_mirror = viewer * [[-1], [-1], [1]] + 0.01 * random_directions(count, 3)
    light[:, ::2] = (near_mirror / np.linalg.norm(near_mirror, axis=0)).astype(np.float32)[:, ::2]
    return light, viewer


def interactions_from(mi: Any, viewer: Any, count: int) -> Any:
    """Return `count` surface interactions, seen from directions [3] or [3, count]."""
    import drjit as dr

    interaction = dr.zeros(mi.SurfaceInteraction3f, count)
    interaction.wi = mi.Vector3f(viewer)
    dr.make_opaque(interaction.wi)  # an input of the kernel, so that it is compiled once for all directions
    return interaction


def assert_samples_follow_density(mi: Any, bsdf: Any, viewer: Any, *, samples: int, rings: int) -> None:
    """Assert that a BSDF draws directions with the density that it states, by Mitsuba's chi-square test.

    Mitsuba's BSDFAdapter is not used: it leaves out draws of weight 0, which occur where metapp clamps values at 0. The
    test writes its data into the current folder if it fails.
    """
    import drjit as dr

    context = mi.BSDFContext()

    def draw(numbers: Any) -> Any:
        sample, _ = bsdf.sample(context, interactions_from(mi, viewer, len(numbers[0])), numbers[0],
                               mi.Point2f(numbers[1], numbers[2]))  # fmt: skip
        is_drawn = sample.pdf > 0
        return dr.select(is_drawn, sample.wo, mi.Vector3f(0, 0, -1)), mi.Float(is_drawn)

    def density(light: Any) -> Any:
        return bsdf.pdf(context, interactions_from(mi, viewer, len(light.x)), light)

    test = mi.chi2.ChiSquareTest(
        mi.chi2.SphericalDomain(), draw, density, sample_dim=3, sample_count=samples, ires=rings
    )
    assert test.run(), test.messages
