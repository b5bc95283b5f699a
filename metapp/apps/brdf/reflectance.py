"""Reflectance, the asset that fits and baselines of BRDFs answer with."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor
from typing_extensions import override

from metapp.appearance.assets import Asset
from metapp.appearance.geometry import quasirandom_angles
from metapp.appearance.pictures import Picture
from metapp.appearance.sphere import reference_scene, shade_sphere
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.sample_augmentation import AUGMENTED_SAMPLES
from metapp.learning.task import Params, Task

SPARSE_SAMPLES = 1024  # samples of a task, up to which its fit is distilled from directions all over the hemisphere


@dataclass(frozen=True, eq=False)
class Reflectance(Asset):
    """The reflectance of a material, a function of two directions.

    Attributes:
        evaluate: a function from half and difference angles, and phi_h of anisotropic materials, [..., 3 or 4] in rad,
            to linear RGB [..., 3] in 1/sr, >= 0, without the cosine.
        is_anisotropic: whether the function reads phi_h.
        theta: the parameters of the network that `evaluate` belongs to, without a task axis; {} if there is none.
    """

    kind = "reflectance"
    evaluate: Callable[[Tensor], Tensor]
    is_anisotropic: bool = False
    theta: Params = field(default_factory=dict)

    @override
    def pictures(self) -> dict[str, Picture]:
        return {}

    @override
    def preview(self) -> Tensor:
        """Return a sphere of the material, linear RGB on black with coverage, [H, W, 4]."""
        return shade_sphere(reference_scene(azimuths=self.is_anisotropic), self.evaluate)

    def sample(self, task: Task) -> Task:
        """Return a task with the values of this reflectance, from which another network can be distilled.

        Args:
            task: the task that was fitted, whose angles are taken; if it has few, angles are taken all over.

        Raises:
            ValueError: the material is anisotropic.
        """
        self.require_isotropic(task.name, "the NBRDF network")
        angles = task.data["angles"]
        if len(angles) <= SPARSE_SAMPLES:
            angles = quasirandom_angles(AUGMENTED_SAMPLES)
        return task._replace(data=task.data | {"angles": angles, "reflectance": self.evaluate(angles)})

    def require_isotropic(self, subject: str | Path, form: str) -> None:
        """Refuse to write an anisotropic material in a form that has no phi_h.

        Args:
            subject: the material's name or file, which begins the message.
            form: the form, as the subject of "has no phi_h".

        Raises:
            ValueError: the material is anisotropic.
        """
        if self.is_anisotropic:
            raise ValueError(
                f"{subject}: an anisotropic fit, expected an isotropic one: {form} has no phi_h; export bsdf or "
                "mitsuba, or fit by --recipe full."
            )


def make_reflectance(app: Brdf, theta: Params, task: Task, size: tuple[int, int] | None) -> Reflectance:
    """Return the reflectance of a fit; see :class:`metapp.application.MakeAsset`."""
    return Reflectance(functools.partial(app.reflectance, theta), app.network.anisotropic, theta)
