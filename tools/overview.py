"""Draw docs/overview.jpg of the folder that `metapp try` writes: overview.py TRY PICTURE.

A column an application: above what its fit sees, or its reference; below what the fit makes.
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

SIDE, GAP, LABEL = 200, 8, 24  # px
Box = tuple[int, int, int, int] | None  # of a picture, px: left, top, right, bottom
Part = tuple[str, Box]

MADE = "{}/meta/*/outputs/*/{}.png"
SHEET = "{}/meta/*/pictures.png"
COLUMNS: dict[str, tuple[Part, Part]] = {
    "BRDF": ((SHEET.format("brdf"), (65, 35, 213, 183)), (SHEET.format("brdf"), (65, 202, 213, 350))),
    "texture": (("inputs/bricks.png", None), (MADE.format("texture", "texture"), (0, 0, 512, 512))),
    "svBRDF, stationary": (
        ("inputs/leather.png", None),
        (MADE.format("svbrdf_stationary", "lit_from_left"), (0, 0, 512, 512)),
    ),
    "svBRDF, non-stationary": (
        ("inputs/mosaic.png", None),
        (MADE.format("svbrdf_nonstationary", "lit_from_left"), None),
    ),
    "illumination": (
        (SHEET.format("illumination"), (64, 33, 214, 183)),
        (SHEET.format("illumination"), (64, 200, 214, 350)),
    ),
    "light transport": ((MADE.format("transport", "regular"), None), (MADE.format("transport", "guided"), None)),
}


def main(folder: Path, out: Path) -> None:
    """Write the picture."""
    size = (len(COLUMNS) * (SIDE + GAP) - GAP, LABEL + 2 * SIDE + GAP)
    result = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(result)
    for i, (label, parts) in enumerate(COLUMNS.items()):
        left = i * (SIDE + GAP)
        draw.text((left + SIDE // 2, LABEL // 2), label, "black", ImageFont.load_default(15), "mm")
        for j, (pattern, box) in enumerate(parts):
            picture = Image.open(next(folder.glob(pattern))).convert("RGB").crop(box)
            picture = picture.resize((SIDE, SIDE), Image.Resampling.LANCZOS)
            result.paste(picture, (left, LABEL + j * (SIDE + GAP)))
    result.save(out, quality=88)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
