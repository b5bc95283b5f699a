"""Options of non-stationary svBRDFs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from metapp.networks.options import STOPS, CameraOptions


@dataclass(frozen=True)
class SvbrdfNonstationaryOptions(CameraOptions):
    """Camera and exposure of the flash photos."""

    stops: Annotated[float, STOPS] = 0.0
