"""The application of BRDFs on half and difference vectors (paper section 4.1.2).

A task is one material, known by samples of its reflectance; losses and errors compare log(1 + f cos theta_i). Which
network a fit has does not matter here: all are used by the methods of :class:`BrdfNetwork`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.brdf.brdf_network import BrdfNetwork, SampleEncoder
from metapp.apps.brdf.held_out_judge import HeldOutJudge
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.apps.brdf.sample_augmentation import mix_brdfs
from metapp.apps.brdf.sample_sight import DistinctSampleSight, SampleSight
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.task import Params, Tasks, TensorSpec


@dataclass(frozen=True)
class Brdf(App):
    """The application of BRDFs: a task is one measured or modelled material.

    If a material is anisotropic, a network that does not read phi_h fits the mean over phi_h.

    Attributes:
        decoder: the network, which evaluates materials, and has General's encoder of its own.
        sight: the samples that fits see; None for the sight that the network needs.
        conserve: whether fits are changed after the last step so that they reflect no more light than they receive.
    """

    decoder: BrdfNetwork = NBRDF_NETWORK
    sight: Any = None
    judge: HeldOutJudge = field(default_factory=HeldOutJudge)
    encoder: SampleEncoder = field(default_factory=SampleEncoder)
    conserve: bool = False
    name = "brdf"
    error_measure = ErrorMeasure(
        "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| over samples that are held out, or all if none is",
        scale=100,
    )
    tensors: ClassVar = {
        "angles": TensorSpec(("N", 3), low=0.0, high=2 * math.pi),
        "phi_h": TensorSpec(("N",), low=0.0, high=2 * math.pi, optional=True),
        "reflectance": TensorSpec(("N", 3), low=0.0),
        "render": TensorSpec(("H", "W", 4), optional=True),
        "environment": TensorSpec(("h", "w", 4), optional=True),
    }
    small_tensors = True

    def __post_init__(self) -> None:
        is_linear = bool(self.decoder.linear_parameter)
        if self.sight is None:  # a network asks for the sight that its rules need
            object.__setattr__(self, "sight", DistinctSampleSight() if is_linear else SampleSight())
        if is_linear and not isinstance(self.sight, DistinctSampleSight):
            raise ValueError(f"brdf: {type(self.sight).__name__}, expected a DistinctSampleSight for this network.")

    @property
    def network(self) -> BrdfNetwork:
        """The network, which is the decoder."""
        return self.decoder

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return mixtures of these materials, with samples as the network learns from them."""
        return tasks.make_variants(self.network.augment(mix_brdfs(tasks, rng), rng))

    @override
    @torch.no_grad()
    def postprocess(self, theta: Params, tasks: Tasks | None = None) -> Params:
        """Hold highlights by samples, and limit fits to the light that they receive, if `conserve` asks for it."""
        theta = theta if tasks is None else self.network.hold_highlight(theta, self.sight.gather(tasks))
        return self.network.conserve_energy(theta) if self.conserve else theta

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Return the reflectance of a fit, linear RGB [..., 3] in 1/sr, without the cosine.

        Args:
            theta: the fit, without a task axis.
            angles: half and difference angles, and phi_h of anisotropic fits, [..., 3 or 4] in rad.
        """
        return self.network.evaluate(theta, angles)
