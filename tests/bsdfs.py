"""BSDFs of Mitsuba for tests: directions, interactions, its own test of sampling."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def directions(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Unit vectors above the surface, [3, count]."""
    vectors = np.random.default_rng(seed).standard_normal((3, count))
    vectors[2] = abs(vectors[2])
    return (vectors / np.linalg.norm(vectors, axis=0)).astype(np.float32)


def mirrored_pairs(count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lights and viewers, [3, count], half of the lights beside the mirror direction."""
    light, viewer = directions(count, 1), directions(count, 2)
    near = viewer * [[-1], [-1], [1]] + 0.01 * directions(count, 3)
    light[:, ::2] = (near / np.linalg.norm(near, axis=0)).astype(np.float32)[:, ::2]
    return light, viewer


def seen_from(mi: Any, viewer: Any, count: int) -> Any:
    """Interactions with viewers, [3] or [3, count]."""
    import drjit as dr

    interaction = dr.zeros(mi.SurfaceInteraction3f, count)
    interaction.wi = mi.Vector3f(viewer)
    dr.make_opaque(interaction.wi)  # no part of the kernel, which is then compiled once for all directions
    return interaction


def assert_sampled_as_densely_as_it_says(mi: Any, bsdf: Any, viewer: Any, *, samples: int, rings: int) -> None:
    """Mitsuba's own test, which writes its data into the current folder where it fails.

    BSDFAdapter leaves out draws of weight 0, which our clamp at 0 makes.
    """
    import drjit as dr

    context = mi.BSDFContext()

    def draw(numbers: Any) -> Any:
        drawn, _ = bsdf.sample(context, seen_from(mi, viewer, len(numbers[0])), numbers[0],
                               mi.Point2f(numbers[1], numbers[2]))  # fmt: skip
        is_drawn = drawn.pdf > 0
        return dr.select(is_drawn, drawn.wo, mi.Vector3f(0, 0, -1)), mi.Float(is_drawn)

    def density(light: Any) -> Any:
        return bsdf.pdf(context, seen_from(mi, viewer, len(light.x)), light)

    test = mi.chi2.ChiSquareTest(
        mi.chi2.SphericalDomain(), draw, density, sample_dim=3, sample_count=samples, ires=rings
    )
    assert test.run(), test.messages
