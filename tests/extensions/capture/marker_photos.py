"""Photographs of the marker sheet by a pinhole camera whose position is known."""

import functools
import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from data_tools.readers.lenses import FILM_DIAGONAL_MM

cv2 = pytest.importorskip("cv2", reason='OpenCV is not installed: pip install "metapp[capture]"')

PX_PER_CM = 80
FOCAL_MM = 26  # 35 mm equivalent
PATCH_PX = 512  # side of the picture that lies in the opening


class Camera(NamedTuple):
    """A camera that looks at the sheet.

    Attributes:
        position: in cm, from the centre of the opening.
        aim: the point of the sheet, in cm, that is in the middle of the photograph.
        roll: rotation about the viewing direction in degrees.
        focal_mm: the focal length, 35 mm equivalent.
        height: of the photograph in px.
        width: of the photograph in px.
    """

    position: tuple[float, float, float]
    aim: tuple[float, float] = (0.0, 0.0)
    roll: float = 0.0
    focal_mm: float = FOCAL_MM
    height: int = 1200
    width: int = 1600

    def projection_matrix(self, height: float = 0.0) -> np.ndarray:
        """Return the matrix [3, 3] from cm on a plane `height` cm above the sheet to px; pixel centres are integers."""
        forward = np.array([*self.aim, 0.0]) - self.position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        cos, sin = math.cos(math.radians(self.roll)), math.sin(math.radians(self.roll))
        axes = np.stack([cos * right + sin * down, cos * down - sin * right, forward])
        focal = self.focal_mm / FILM_DIAGONAL_MM * math.hypot(self.height, self.width)
        lens = np.array([[focal, 0, (self.width - 1) / 2], [0, focal, (self.height - 1) / 2], [0, 0, 1]])
        return lens @ np.column_stack([axes[:, :2], -axes @ (self.position - np.array([0.0, 0.0, height]))])


def tilted_camera(degrees: float, azimuth: float = 0.0, distance: float = 28.0, **camera_options: float) -> Camera:
    """Return a camera at a distance in cm from the opening's centre, at an angle to the normal and an azimuth."""
    slope, turn = math.radians(degrees), math.radians(azimuth)
    aside = distance * math.sin(slope)
    position = aside * math.cos(turn), aside * math.sin(turn), distance * math.cos(slope)
    return Camera(position, **camera_options)


@functools.lru_cache(4)
def printed_page(opening: int, paper: str = "a4") -> tuple[np.ndarray, tuple[float, float]]:
    """Return the printed page [H, W] in [0, 1] and the opening's centre in cm from the page's lower left."""
    from metapp.extensions.capture.rectified.sheet_page import draw_marker_sheet

    drawn = draw_marker_sheet(opening, paper)
    (axes,) = drawn.axes
    for patch_of_page in axes.patches:
        patch_of_page.set_snap(False)  # no rounding to whole pixels, since a printer does not round
    stream = io.BytesIO()
    drawn.savefig(stream, format="png", dpi=PX_PER_CM * 2.54)
    return np.asarray(Image.open(stream).convert("L")) / 255.0, (-axes.get_xlim()[0], -axes.get_ylim()[0])


@functools.cache
def patch_picture() -> np.ndarray:
    """Return the picture in the opening, sRGB [PATCH_PX, PATCH_PX, 3] in [0, 1], which photographs can resolve."""
    rng = np.random.default_rng(4)
    coarse = cv2.resize(rng.uniform(0.2, 0.8, (24, 24, 3)), (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_CUBIC)
    fine = cv2.resize(rng.uniform(-0.1, 0.1, (96, 96, 3)), (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_CUBIC)
    return (coarse + fine).clip(0, 1)


def sheet_on_patch(opening: int = 10, bend: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the page with the picture in its opening [H, W, 3], and the matrix [3, 3] from cm to its pixels.

    `bend` shifts the part right of the opening by so many cm.
    """
    paper, centre = printed_page(opening)
    values = np.repeat(paper[..., None], 3, -1)
    side = opening * PX_PER_CM
    left, top = round(centre[0] * PX_PER_CM - side / 2), round(len(paper) - centre[1] * PX_PER_CM - side / 2)
    to_page = np.array([[PX_PER_CM, 0, left + side / 2 - 0.5], [0, -PX_PER_CM, top + side / 2 - 0.5], [0, 0, 1]])
    cut = 12  # px, 0.15 cm: a dark margin around the picture
    values[top - cut : top + side + cut, left - cut : left + side + cut] = 0.3
    values[top : top + side, left : left + side] = cv2.resize(
        patch_picture(), (side, side), interpolation=cv2.INTER_AREA
    )
    if bend:
        right = left + side + cut
        values[:, right:] = np.roll(values[:, right:], round(bend * PX_PER_CM), 0)
    return values, to_page


def photograph(
    camera: Camera,
    opening: int = 10,
    vignette: float = 0.0,
    noise: float = 0.0,
    bend: float = 0.0,
) -> np.ndarray:
    """Return a photograph of the sheet on a gray table, sRGB [height, width, 3] in [0, 1], four samples a pixel."""
    values, to_page = sheet_on_patch(opening, bend)
    many = 2
    finer = np.array([[many, 0, (many - 1) / 2], [0, many, (many - 1) / 2], [0, 0, 1]])
    warp = finer @ camera.projection_matrix() @ np.linalg.inv(to_page)
    size = camera.width * many, camera.height * many
    large = cv2.warpPerspective(values.astype(np.float32), warp, size, flags=cv2.INTER_LINEAR, borderValue=(0.4,) * 3)
    seen = cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA).astype(np.float64)
    y, x = np.mgrid[: camera.height, : camera.width]
    off = np.hypot(x - camera.width / 2, y - camera.height / 2) / math.hypot(camera.width, camera.height) * 2
    seen *= (1 - vignette * off**2)[..., None]
    return (seen + np.random.default_rng(1).normal(0, 1, seen.shape) * noise).clip(0, 1)


def write_photograph(path: Path, camera: Camera, focal: bool = True, **look: Any) -> Path:
    """Write a photograph in the format of the suffix, with the focal length in its EXIF if `focal`."""
    image = Image.fromarray((photograph(camera, **look) * 255 + 0.5).astype(np.uint8))
    exif = image.getexif()
    if focal:
        exif.get_ifd(0x8769)[0xA405] = round(camera.focal_mm)
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, exif=exif.tobytes(), **({"quality": 92} if path.suffix == ".jpg" else {}))
    return path
