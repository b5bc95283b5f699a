"""The options of the application illumination. Help and completion read this module, so it imports nothing large."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from typing_extensions import override

from metapp.apps.picture_options import CameraOptions, fov_option, pitch_option, size_option
from metapp.options import INPUT, Option


@dataclass(frozen=True)
class IlluminationOptions(CameraOptions):
    """The options of illumination: size and level of the map, camera, and shutter times of photos of a mirror ball."""

    size: Annotated[tuple[int, int] | None, size_option("the map, up to 1024x2048")] = None
    fov: Annotated[float, fov_option("EXIF's, else a distant camera")] = 0.0
    shutter: Annotated[
        str,
        Option(
            "Shutter times, such as 1/20,1/60, or auto, of INPUT: photos of one mirror ball, to merge.",
            "T,T,...",
            panel=INPUT,
            observes="photo",
        ),
    ] = ""

    pitch: Annotated[float, pitch_option()] = 0.0

    @override
    def adapt_asset(self, asset: Any) -> Any:
        """Turn the map so that its horizon lies level."""
        return asset.level(self.pitch) if self.pitch else asset

    @override
    def reader_keywords(self) -> dict[str, Any]:
        """Leave out the shutter times: readers read single photos, which are merged by them later."""
        return {name: value for name, value in super().reader_keywords().items() if name != "shutter"}
