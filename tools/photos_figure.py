"""Draw photographs before and after: photos_figure.py PICTURE APP:PHOTO...

APP is texture, svbrdf_stationary or svbrdf_nonstationary. A column a photo: the photo, Meta by `quick`, and by
`full`, at the scale of the photo; of materials normals, diffuse colour, roughness, and lit from the left.
"""

import sys
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

import metapp
from metapp.apps import presentation_of

CELL = 256  # px
MAPS = ("normal", "diffuse", "roughness", "lit_from_left")


def cell(picture: Tensor, side: int = CELL) -> Tensor:
    """A picture [H, W, 1 or 3] as [3, side, side]."""
    whole = picture.permute(2, 0, 1).expand(3, -1, -1)[None]
    return interpolate(whole, size=(side, side), mode="bilinear", antialias=True)[0].clamp(0, 1)


def fitted(app: str, photo: Path, recipe: str) -> metapp.Fit:
    """Meta's fit of a photo by a recipe."""
    observe = {"observe": "photo"} if app == "svbrdf_nonstationary" else {}
    fit = metapp.fit(app, photo, recipe=recipe, **observe)
    print(f"{photo.name}: {recipe}, {fit.seconds:.1f} s", flush=True)
    return fit


def drawn(fit: metapp.Fit) -> Tensor:
    """What a fit makes, [3, CELL, CELL]."""
    files = presentation_of(fit.app).files(fit.parameters, fit.task)
    found = {name: file.pixels for name, file in files.items()}
    if fit.app.name != "svbrdf_nonstationary":  # four photos wide and high
        found = {name: each[: each.shape[0] // 4, : each.shape[1] // 4] for name, each in found.items()}
    if fit.app.name == "texture":
        return cell(found["texture"])
    parts = [cell(found[name], CELL // 2) for name in MAPS]
    return torch.cat([torch.cat(parts[:2], 2), torch.cat(parts[2:], 2)], 1)


def column(app: str, photo: Path) -> Tensor:
    """The photo above both fits, [3, 3 CELL, CELL]."""
    fits = [fitted(app, photo, recipe) for recipe in ("quick", "full")]
    data = fits[-1].task.data
    image = data["photo" if "photo" in data else "image"].float() / 255
    return torch.cat([cell(image.permute(1, 2, 0)), *map(drawn, fits)], 1)


def write(picture: Path, whole: Tensor) -> None:
    """Write a picture [3, H, W], PNG or JPEG by its name."""
    import OpenImageIO as oiio

    pixels = (whole.permute(1, 2, 0) * 255).round().clamp(0, 255).byte().contiguous().numpy()
    image = oiio.ImageBuf(pixels)
    image.specmod().attribute("Compression", "jpeg:85")
    if not image.write(str(picture)):
        raise SystemExit(f"{picture}: not written ({image.geterror()}).")


def main(picture: Path, named: list[str]) -> None:
    """Draw the columns of the photos that were named."""
    columns = [column(app, Path(photo)) for app, _, photo in (each.partition(":") for each in named)]
    write(picture, torch.cat(columns, 2))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
