"""The options of stationary svBRDFs."""

from __future__ import annotations

from dataclasses import dataclass

from metapp.apps.exemplar.options import ExemplarOptions
from metapp.networks.picture_options import CameraOptions, ReliefOptions


@dataclass(frozen=True)
class FlashExemplarOptions(ReliefOptions, ExemplarOptions, CameraOptions):
    """Size, detail and relief of maps that tile, and the camera of the flash photo."""
