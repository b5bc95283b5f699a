"""Pictures of BRDFs that cost nothing, for tests of what happens around them."""

import functools
import warnings

import pytest

from metapp.appearance.sphere import reference_scene


def shrink_spheres(patch: pytest.MonkeyPatch) -> None:
    """Have BRDFs drawn at 16 px instead of 96."""
    small = functools.partial(reference_scene, 16)
    for module in ("metapp.apps.brdf.presenter", "data_tools.readers.brdf_task"):
        patch.setattr(f"{module}.reference_scene", small)


def run_small(*words: object) -> None:
    """Run `metapp` for a fixture, at 16 px; its random networks reflect too much, of which nobody need be warned."""
    from metapp.cli.command_tree import app

    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shrink_spheres(patch)
        app([str(word) for word in words], standalone_mode=False)
