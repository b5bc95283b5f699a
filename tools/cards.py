"""Make the cards of docs/what-can-i-make.md, 720 x 360 px, of pictures that commands have written: cards.py FOLDER OUT.

FOLDER holds exemplars of the embedded data sets as pictures (`metapp data synth APP` draws these), ball0.jpg to
ball2.jpg (`metapp.appearance.photograph.render_mirror_spheres` of a map of `metapp data synth illumination --rows 256`,
on grey, each a third as bright as the one before), and the runs of

    metapp meta texture bricks.png --size 512
    metapp meta svbrdf_stationary rust.png leather.png --export blender
    metapp meta svbrdf_nonstationary sign.png
    metapp meta transport --data boxes --render 256       (metapp data cornell --count 2 --split test --out boxes)
    metapp baseline texture bricks.png --method quilting
    metapp data ball ball0.jpg ball1.jpg ball2.jpg --shutter 1/20,1/60,1/180 --out garden
    metapp meta brdf; metapp evaluate brdf --recipe quick; metapp compare RUN RUN --out compare.png     (Meta, QuickFT)

All other parts of cards are cut from pictures of docs/.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import OpenImageIO as oiio
import torch
from PIL import Image

from metapp.appearance.colour import linear_to_srgb

# a part of a card: a file name or pattern, and the box to cut out (left, upper, right, lower, in px) or None for all
CardPart = tuple[str, tuple[int, int, int, int] | None]
DOCS_FOLDER = Path(__file__).parent.parent / "docs"
CARD_HEIGHT_PX, CARD_WIDTH_PX, CARD_GAP_PX = 360, 720, 4
UPPER_LEFT_BOX = (0, 0, 512, 512)  # px
STATIONARY_PATTERN = "runs/svbrdf_stationary/meta*/*{}*/{}.png"
NONSTATIONARY_PATTERN = "runs/svbrdf_nonstationary/meta*/*sign*/{}.png"
CORNELL_PATTERN = "runs/transport/meta*/cornell-0-000/{}.png"


def map_rows(pattern: str, names: Sequence[str], box: tuple[int, int, int, int] | None) -> list[list[CardPart]]:
    """Return the parts of four maps in two rows of two."""
    parts = [(pattern.format(name), box) for name in names]
    return [parts[:2], parts[2:]]


# columns of each card, left to right; a column is a list of rows, a row is a list of parts
CARD_COLUMNS: dict[str, list[list[list[CardPart]]]] = {
    "brdf": [[[("demo.png", (372, 32, 996, 350))]]],
    "texture": [[[("bricks.png", None)]], [[("runs/texture/meta*/*bricks*/texture.png", UPPER_LEFT_BOX)]]],
    "svbrdf-stationary": [
        [[("rust.png", None)]],
        map_rows(STATIONARY_PATTERN.format("rust", "{}"), ("diffuse", "roughness", "normal", "lit_from_left"), None),
    ],
    "svbrdf-nonstationary": [
        [[("sign.png", None)]],
        map_rows(NONSTATIONARY_PATTERN, ("diffuse", "roughness", "normal", "lit_from_left"), None),
    ],
    "illumination": [
        [[("ball-to-hdr.jpg", (0, 0, 192, 192))]],
        [[("ball-to-hdr.jpg", (208, 0, 592, 192))], [("ball-to-hdr.jpg", (608, 24, 896, 168))]],
    ],
    "transport": [[[(CORNELL_PATTERN.format("guided_path"), None)]], [[(CORNELL_PATTERN.format("regular_nee"), None)]]],
    "maps": [
        [[(STATIONARY_PATTERN.format("leather", "lit_from_left"), None)]],
        map_rows(STATIONARY_PATTERN.format("leather", "{}"), ("diffuse", "roughness", "normal", "specular"), None),
    ],
    "ball": [
        [[("garden/found/ball0.png", (90, 0, 630, 540))]],
        [[("garden/garden.exr*3", None)], [("garden/garden.exr*0.3", None)]],
    ],
    "compare": [[[("compare.png", (0, 30, 991, 525))]]],
    "report": [[[("report.jpg", None)]]],
    "baseline": [[[("bricks.png", None)]], [[("runs/texture/baseline*/*bricks*/texture.png", None)]]],
    "guided": [[[("guiding-scenes.jpg", (0, 14, 258, 272))]], [[("guiding-scenes.jpg", (261, 14, 519, 272))]]],
}


def open_picture(folder: Path, name: str) -> Image.Image:
    """Open a picture of a folder, or of docs/ if the folder lacks it.

    The name of a linear picture (.exr) ends in `*` and a factor, which multiplies it before it is encoded as sRGB.
    """
    path, exr_mark, factor = name.partition(".exr*")
    if not exr_mark:
        return Image.open(next(folder.glob(name), DOCS_FOLDER / name)).convert("RGB")
    pixels = oiio.ImageBuf(str(folder / f"{path}.exr")).get_pixels(oiio.FLOAT)
    assert pixels is not None, name
    srgb = linear_to_srgb((torch.from_numpy(pixels[..., :3]) * float(factor)).clamp(0, 1))
    return Image.fromarray((srgb * 255).round().to(torch.uint8).numpy())


def compose_card(folder: Path, columns: list[list[list[CardPart]]]) -> Image.Image:
    """Compose a card of columns of equal width, each of rows of equal height, each of parts of equal width."""
    card = Image.new("RGB", (CARD_WIDTH_PX, CARD_HEIGHT_PX), "white")
    for column_index, column in enumerate(columns):
        for row_index, row in enumerate(column):
            for part_index, (name, box) in enumerate(row):
                width, height = CARD_WIDTH_PX // len(columns) // len(row), CARD_HEIGHT_PX // len(column)
                part = open_picture(folder, name).crop(box) if box else open_picture(folder, name)
                place = (column_index * CARD_WIDTH_PX // len(columns) + part_index * width, row_index * height)
                card.paste(part.resize((width - CARD_GAP_PX, height - CARD_GAP_PX), Image.Resampling.LANCZOS), place)
    return card.crop((0, 0, CARD_WIDTH_PX - CARD_GAP_PX, CARD_HEIGHT_PX - CARD_GAP_PX))


def main(folder: Path, out: Path) -> None:
    """Write all cards as JPEG files."""
    out.mkdir(parents=True, exist_ok=True)
    for name, columns in CARD_COLUMNS.items():
        compose_card(folder, columns).save(out / f"{name}.jpg", quality=88)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
