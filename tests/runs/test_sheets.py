"""Contact sheets: they hold all pictures, in the shapes that these have."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from metapp.runs.outputs.contact_sheet import (
    MAX_SHEET_ROWS,
    TILE_PX,
    Tiles,
    write_contact_sheet,
    write_run_sheet,
)
from metapp.storage.files import PARTIAL_PREFIX
from metapp.storage.fit_folders import RECORD

COLOURS = {"reference": (1.0, 0.0, 0.0), "meta": (0.0, 1.0, 0.0), "general": (0.0, 0.0, 1.0)}


def plain(row: str, height: int = 20, width: int = 20) -> np.ndarray:
    return np.broadcast_to(np.array(COLOURS[row]), (height, width, 3))


def sheet(tasks: list[Tiles], path: Path, count: int = 0) -> np.ndarray:
    pixels: np.ndarray = oiio.ImageBuf(str(write_contact_sheet(tasks, "title", path, count))).get_pixels(oiio.FLOAT)
    return pixels


def places(pixels: np.ndarray, row: str) -> np.ndarray:
    return np.argwhere(np.abs(pixels - COLOURS[row]).max(-1) < 0.02)


def test_the_first_tasks_have_a_row_each(tmp_path: Path) -> None:
    """The reference comes first, and a line says how many more tasks there are."""
    tasks = [
        Tiles({"meta": plain("meta"), "reference": plain("reference")}, f"task {i}") for i in range(MAX_SHEET_ROWS + 2)
    ]
    pixels = sheet(tasks, tmp_path / "sheet.png")
    assert len(places(pixels, "meta")) == len(places(pixels, "reference")) == MAX_SHEET_ROWS * TILE_PX**2
    assert places(pixels, "reference").max(0)[1] < places(pixels, "meta").min(0)[1]
    assert list(tmp_path.iterdir()) == [tmp_path / "sheet.png"]
    few = sheet(tasks[:MAX_SHEET_ROWS], tmp_path / "sheet.png")
    more = sheet(tasks[:MAX_SHEET_ROWS], tmp_path / "sheet.png", 1000)
    assert len(few) < len(more) == len(pixels)
    assert (more[len(few) :] < 0.5).any()


def test_the_reference_of_a_map_stands_below_it(tmp_path: Path) -> None:
    pixels = sheet([Tiles({"meta": plain("meta"), "reference meta": plain("reference")}, "a")], tmp_path / "sheet.png")
    (top, left), (below, same) = (places(pixels, row).min(0) for row in ("meta", "reference"))
    assert (left, below >= top + TILE_PX) == (same, True)


def test_missing_pictures_of_a_task_stay_blank(tmp_path: Path) -> None:
    tasks = [Tiles({"general": plain("general")}, "a"), Tiles({"reference": plain("reference")}, "b", {"": "0.5"})]
    pixels = sheet(tasks, tmp_path / "sheet.png")
    assert len(places(pixels, "general")) == len(places(pixels, "reference")) == TILE_PX**2


def test_shapes_are_kept_and_long_names_cut(tmp_path: Path) -> None:
    tasks = [Tiles({"meta": plain("meta", 10, 40)}, "a name that is far too long for one row " * 9)]
    pixels = sheet(tasks, tmp_path / "sheet.png")
    height, width = np.ptp(places(pixels, "meta"), axis=0) + 1
    assert abs(width / height - 4) < 0.1
    assert pixels.shape[1] < 2 * width


def test_the_sheet_of_a_run_shows_the_fits_of_the_last_command_and_counts_the_others(tmp_path: Path) -> None:
    red, green = (Tiles({"meta": plain(row)}, row) for row in ("reference", "meta"))

    def drawn(tiles: list[Tiles]) -> np.ndarray:
        pixels: np.ndarray = oiio.ImageBuf(str(write_run_sheet(tiles, "title", tmp_path))).get_pixels(oiio.FLOAT)
        return pixels

    (tmp_path / "a").mkdir()
    (tmp_path / "a" / RECORD).touch()
    assert drawn([red]).shape == drawn([green]).shape
    pixels = drawn([green])
    assert (len(places(pixels, "meta")), len(places(pixels, "reference"))) == (TILE_PX**2, 0)
    for name in (f"{PARTIAL_PREFIX}b", "no fit"):
        (tmp_path / name).mkdir()
    (tmp_path / f"{PARTIAL_PREFIX}b" / RECORD).touch()
    assert (drawn([green]) == pixels).all()
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / RECORD).touch()
    counted = drawn([green])
    assert (counted[: len(pixels)] == pixels).all()
    assert (counted[len(pixels) :] < 0.5).any()
    assert (counted == sheet([green], tmp_path / "sheet.png", 2)).all()


def test_umlauts_are_drawn(tmp_path: Path) -> None:
    """A letter that a font lacks is a box, the same for all."""
    tasks = [Tiles({"meta": plain("meta")}, name) for name in "üßÉ"]
    drawn = [sheet([task], tmp_path / "sheet.png") for task in tasks]
    assert not (drawn[0] == drawn[1]).all()
    assert not (drawn[1] == drawn[2]).all()
