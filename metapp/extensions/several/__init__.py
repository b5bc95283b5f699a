"""Several flash photos of one flat material, with the places of camera and flash: their format and their recipe."""

from __future__ import annotations

from metapp.door import Chosen, Format, Recipe

_HERE = "metapp.extensions.several"
OFFERS = (
    Format(
        "placed",
        "svbrdf_nonstationary",
        f"{_HERE}.photos",
        "folders of rectified flash photos of one material with camera_pos.txt, light_pos.txt, image_size.txt",
        takes=("size", "stops"),
    ),
    Recipe(
        "svbrdf_nonstationary",
        "several",
        f"{_HERE}.recipe:SEVERAL",
        "photo",
        Chosen(("placed",), has="several photos", tensor="places"),
        f"{_HERE}.checkpoints",
    ),
)
