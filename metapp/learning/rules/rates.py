"""Learned rates: how long a step is, for each weight."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules.descent import half_cosine, like
from metapp.learning.rules.part import Part
from metapp.learning.task import Params


class SignedRates(Part):
    """One rate per weight, the same at every step, of any sign: `rate.<parameter>` [1, ...] (Li et al. 2017)."""

    name = "sgd"
    is_rate = True

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The rate of `first` for all."""
        return {f"rate.{key}": torch.full_like(value, first.rate)[None] for key, value in theta.items()}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Rate times update."""
        return {key: alpha[f"rate.{key}"] * update for key, update in updates.items()}


class Rates(Part):
    """The logarithm of a rate per weight and step: `rate.<parameter>` [steps, ...]."""

    name = "rates"
    is_rate = True

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The half cosine of `first` for all."""
        rates = half_cosine(first.rate, steps, first.final).log()
        return {f"rate.{key}": like(rates, value[None]).repeat(1, *value.shape) for key, value in theta.items()}

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Rate times update; the logarithms of rate and pace, where there are paces, add up."""
        return {key: torch.exp(_logarithm(alpha, key)) * update for key, update in updates.items()}


class SharedRates(Rates):
    """The logarithm of a rate per weight, the same at every step: `rate.<parameter>` [1, ...]."""

    name = "shared"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The first rate of `first` for all."""
        return {key: value[:1] for key, value in super().initial(app, theta, steps, first).items()}


class Paces(Part):
    """The logarithm of a factor per parameter tensor and step: `pace.<parameter>` [steps].

    With shared rates, a rule is as small as one of signed rates: "tied".
    """

    name = "pace"
    beside = (Rates.name, SharedRates.name)

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The half cosine of `first`, relative to its first rate."""
        paces = half_cosine(1.0, steps, first.final).log()
        return {f"pace.{key}": paces.clone() for key in theta}


def _logarithm(alpha: Params, key: str) -> Tensor:
    rate = alpha[f"rate.{key}"]
    return rate + like(alpha[f"pace.{key}"], rate) if f"pace.{key}" in alpha else rate
