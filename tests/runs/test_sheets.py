"""Contact sheets: all pictures are there, in the shapes that they have."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from metapp.runs.outputs.pictures import COLUMNS, SIDE, Column, write_sheet

COLOURS = {"reference": (1.0, 0.0, 0.0), "meta": (0.0, 1.0, 0.0), "general": (0.0, 0.0, 1.0)}


def plain(row: str, height: int = 20, width: int = 20) -> np.ndarray:
    return np.broadcast_to(np.array(COLOURS[row]), (height, width, 3))


def sheet(tasks: list[Column], path: Path) -> np.ndarray:
    pixels: np.ndarray = oiio.ImageBuf(str(write_sheet(tasks, "title", path))).get_pixels(oiio.FLOAT)
    return pixels


def area(pixels: np.ndarray, row: str) -> int:
    return int((np.abs(pixels - COLOURS[row]).max(-1) < 0.02).sum())


def test_all_pictures_are_there(tmp_path: Path) -> None:
    """Also of more tasks than there are columns; the reference is on top, though it comes last."""
    tasks = [
        Column({f"meta 0.{i}": plain("meta"), "reference": plain("reference")}, f"task {i}") for i in range(COLUMNS + 2)
    ]
    pixels = sheet(tasks, tmp_path / "sheet.png")
    for row in ("meta", "reference"):
        assert area(pixels, row) == (COLUMNS + 2) * SIDE**2
    rows = {row: np.nonzero((np.abs(pixels - COLOURS[row]).max(-1) < 0.02).any(1))[0] for row in ("meta", "reference")}
    assert rows["reference"].min() < rows["meta"].min()
    assert list(tmp_path.iterdir()) == [tmp_path / "sheet.png"]


def test_what_a_task_lacks_stays_blank(tmp_path: Path) -> None:
    tasks = [Column({"general": plain("general")}, "a"), Column({"reference": plain("reference")}, "b", "0.5")]
    pixels = sheet(tasks, tmp_path / "sheet.png")
    assert area(pixels, "general") == area(pixels, "reference") == SIDE**2


def test_shapes_are_kept_and_long_names_cut(tmp_path: Path) -> None:
    tasks = [Column({"meta": plain("meta", 10, 40)}, "a name that is far too long for one column " * 4)]
    pixels = sheet(tasks, tmp_path / "sheet.png")
    found = np.argwhere(np.abs(pixels - COLOURS["meta"]).max(-1) < 0.02)
    height, width = np.ptp(found, axis=0) + 1
    assert abs(width / height - 4) < 0.1
    assert pixels.shape[1] < 2 * width
