"""Options of stationary svBRDFs."""

from dataclasses import dataclass

from metapp.networks.options import CameraOptions, ExemplarOptions


@dataclass(frozen=True)
class SvbrdfStationaryOptions(ExemplarOptions, CameraOptions):
    """Size and detail of the maps, and the camera of the flash photo."""
