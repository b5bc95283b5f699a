"""Several flash photos of one flat material, with the places of camera and flash: their format and their recipe."""

from __future__ import annotations

from metapp.registry import Format, Recipe, Registry

_HERE = "metapp.extensions.several"


def register(registry: Registry) -> None:
    """Add the folders and their recipe."""
    registry.formats["placed"] = Format(
        f"{_HERE}.photos",
        app="svbrdf_nonstationary",
        inputs="folders of rectified flash photos of one material with camera_pos.txt, light_pos.txt, image_size.txt",
        takes=("size", "stops"),
        kinds=(("places", ""),),
    )
    registry.recipes["svbrdf_nonstationary", "photo", "several"] = Recipe(
        f"{_HERE}.recipe:SEVERAL", help="several photos", kind="places", checkpoints=f"{_HERE}.checkpoints"
    )
