"""The photographs under many lamps of a fit's task."""

from __future__ import annotations

from torch import Tensor

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.rti.rti_app import RtiApp
from metapp.learning.task import Task


def get_lit_photos(app: SvbrdfNonstationary, task: Task) -> tuple[Tensor, Tensor]:
    """Return the photographs of a task, sRGB uint8 [N, 3, H, W], and unit vectors towards their lamps, [N, 3].

    Raises:
        ValueError: fits of the application are not made of photographs under many lamps.
        KeyError: the task's data were not given.
    """
    if not isinstance(app, RtiApp):
        raise ValueError(
            f"{task.name}: a fit of flash photos or maps, expected one of photos under many lamps, by the recipe rti; "
            "fit a folder with a text .lp of light directions; export gltf, mitsuba or another material of this one."
        )
    return task.data["lit"], task.data["lamps"].float()
