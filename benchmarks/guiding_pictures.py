"""One figure of pictures in equal time: `path`, `guided_path` and a reference, each with an enlarged part.

guiding_pictures.py OUT.jpg SCENE@X,Y ... draws a row for each scene: the name of one of `bench_guiding`, or a scene
file of Mitsuba 3, and the middle of the part, from 0 to 1.
"""

from __future__ import annotations

import argparse
import io
import warnings
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

import metapp.mitsuba  # noqa: F401  (registers guided_path)
from benchmarks.bench_guiding import REGULAR, Bench, box_filtered
from benchmarks.guiding_scenes import scenes
from data_tools.synthetic.cornell import Scene
from metapp.appearance.metrics import mape
from metapp.extensions.guided import equal_time
from metapp.extensions.scene_files.reading import read_scene
from metapp.rendering.paths.path_space import DEPTH
from metapp.rendering.pictures import rendered
from metapp.rendering.scenes.loading import load_scene
from metapp.storage.files import write_atomically

METHODS = {REGULAR: "path", "guided + NEE": "guided_path"}
LARGEST = 240_000  # bytes of the file
PART = 72  # px across the part that is enlarged
ZOOM = 2
GAP, TITLE = 4, 16  # px
BRIGHT = 90.0  # percentile of the reference that is shown as a bright grey


class Pictures(Bench):
    """A scene, and its pictures.

    Args:
        scene: a dictionary.
        size: px along the longer side.
    """

    def __init__(self, scene: Scene, size: int) -> None:
        self.mi, self.scene, _ = load_scene(scene)
        equal_time.resize(self.scene, size)
        self.width, self.height = (int(n) for n in self.scene.sensors()[0].film().size())
        self.path = self.mi.load_dict({"type": "path", "max_depth": DEPTH})
        self.costs = {name: self._first(name) for name in METHODS}
        self.last = torch.zeros(())

    def error(self, picture: Tensor) -> float:
        """Keep the picture; its error is not known yet."""
        self.last = picture
        return 0.0

    def reference(self, spp: int, seed: int) -> Tensor:
        """A picture by `path`."""
        waves = [rendered(self.scene, self.path, 64, seed + wave) for wave in range(-(-spp // 64))]
        return torch.stack(waves).mean(0)


def shown(picture: Tensor, exposure: float) -> Image.Image:
    """A linear picture as sRGB."""
    linear = (picture * exposure).clamp(0, 1).numpy()
    encoded = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return Image.fromarray(np.round(255 * encoded).astype(np.uint8))


def pictures(bench: Pictures, options: argparse.Namespace) -> dict[str, Tensor]:
    """By their titles."""
    reference = bench.reference(options.reference, 2**20)
    result = {}
    for method, title in METHODS.items():
        made = bench.measured(method, options.seconds, options.seed)
        error = mape(bench.last.permute(2, 0, 1)[None], reference.permute(2, 0, 1)[None])
        title = f"{title}, {made['seconds']:.1f} s, {made['spp']} spp, MAPE {float(error):.2f}"
        result[title] = bench.last
        print(f"{title}, mean {float(bench.last.mean() / reference.mean()):.3f} of the reference's", flush=True)
    return result | {f"reference, path, {options.reference} spp": reference}


def row(name: str, place: tuple[float, float], options: argparse.Namespace) -> Image.Image:
    """Pictures of one scene side by side, titles above, then their parts."""
    bench = Pictures(scenes()[name] if name in scenes() else box_filtered(read_scene(Path(name))), options.size)
    made = pictures(bench, options)
    exposure = 0.8 / float(np.percentile(list(made.values())[-1].numpy(), BRIGHT))
    drawn = {title: shown(picture, exposure) for title, picture in made.items()}
    tall = bench.height // ZOOM
    left = min(max(0, round(place[0] * bench.width) - PART // 2), bench.width - PART)
    top = min(max(0, round(place[1] * bench.height) - tall // 2), bench.height - tall)
    for title, one in list(drawn.items()):
        part = one.crop((left, top, left + PART, top + tall))
        drawn[f"{ZOOM}:1, {title.split(',')[0]}"] = part.resize((PART * ZOOM, tall * ZOOM), Image.Resampling.NEAREST)
    width = sum(one.width + GAP for one in drawn.values()) - GAP
    sheet, x = Image.new("RGB", (width, bench.height + TITLE), "white"), 0
    for title, one in drawn.items():
        sheet.paste(one, (x, TITLE))
        ImageDraw.Draw(sheet).text((x + 1, 1), title, "black", ImageFont.load_default(11))
        x += one.width + GAP
    return sheet


def write(sheet: Image.Image, file: Path) -> None:
    """As JPEG, of the best quality that fits."""
    for quality in range(92, 30, -2):
        held = io.BytesIO()
        sheet.save(held, "JPEG", quality=quality, optimize=True)
        if held.tell() <= LARGEST:
            break
    write_atomically(file, lambda path: path.write_bytes(held.getvalue()))


def main() -> None:
    """Render all, and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--size", type=int, default=256, help="px along the longer side")
    parser.add_argument("--seconds", type=float, default=4.0, help="of CPU, of a picture")
    parser.add_argument("--reference", type=int, default=1024, help="samples a pixel of the reference")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    for each in options.scenes:
        name, _, place = each.partition("@")
        x, y = (float(value) for value in (place or "0.5,0.5").split(","))
        rows.append(row(name, (x, y), options))
    sheet = Image.new("RGB", (max(one.width for one in rows), sum(one.height + GAP for one in rows)), "white")
    y = 0
    for one in rows:
        sheet.paste(one, (0, y))
        y += one.height + GAP
    write(sheet, options.out)


if __name__ == "__main__":
    main()
