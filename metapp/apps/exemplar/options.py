"""Options of applications that generate pictures with the statistics of an exemplar.

Help and completion read this module, so it imports nothing large before an option takes effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from metapp.apps.picture_options import PictureOptions, size_option


@dataclass(frozen=True)
class ExemplarOptions(PictureOptions):
    """The options of textures, and of other pictures like an exemplar: their size."""

    size: Annotated[tuple[int, int] | None, size_option("textures and maps up to 4096x4096")] = None
