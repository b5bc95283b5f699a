"""Pictures of BRDFs that cost nothing, for tests of what happens around them."""

import functools

import pytest

from metapp.appearance.sphere import sphere_scene


def shrink_spheres(patch: pytest.MonkeyPatch) -> None:
    """Have BRDFs drawn at 16 px instead of 96."""
    small = functools.cache(functools.partial(sphere_scene, 16))
    for module in ("metapp.apps.brdf.presentation", "data_tools.readers.brdf_task", "data_tools.readers.gonio"):
        patch.setattr(f"{module}.reference_scene", small)
