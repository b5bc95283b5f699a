"""The options of stationary svBRDFs. Help and completion read this module, so it imports nothing large."""

from __future__ import annotations

from dataclasses import dataclass

from metapp.apps.exemplar.options import ExemplarOptions
from metapp.apps.picture_options import CameraOptions, ReliefOptions


@dataclass(frozen=True)
class FlashExemplarOptions(ReliefOptions, ExemplarOptions, CameraOptions):
    """The options of stationary svBRDFs: size and relief of maps that tile, and the flash photo's camera."""
