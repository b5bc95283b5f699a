"""Pictures of BRDFs at 16 px, which take no time, for tests to which their content does not matter."""

import functools
import warnings

import pytest

from metapp.appearance.sphere import reference_scene


def shrink_spheres(patch: pytest.MonkeyPatch) -> None:
    """Have pictures of BRDFs drawn at 16 px instead of 96."""
    small = functools.partial(reference_scene, 16)
    for module in ("metapp.apps.brdf.presenter", "data_tools.readers.brdf_task"):
        patch.setattr(f"{module}.reference_scene", small)


def run_with_small_spheres(*words: object) -> None:
    """Run `metapp` for a fixture with pictures of 16 px, without warnings: random networks reflect too much light."""
    from metapp.cli.command_tree import app

    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shrink_spheres(patch)
        app([str(word) for word in words], standalone_mode=False)
