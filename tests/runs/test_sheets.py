"""Contact sheets: they hold all pictures, in the shapes that these have."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from metapp.runs.outputs.contact_sheet import (
    MAX_SHEET_ROWS,
    ROW_MARKS_KEY,
    SHEET_FILE_NAME,
    TILE_PX,
    Tiles,
    add_to_sheet,
    read_rows,
    write_contact_sheet,
)

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


def test_a_sheet_keeps_rows_of_before(tmp_path: Path) -> None:
    """It keeps rows of fits that still exist and are not drawn again, newest first.

    Of files that are no sheet it keeps none.
    """
    red, green = (Tiles({"meta": plain(row)}, row) for row in ("reference", "meta"))
    for name in ("a", "b", "c", "gone"):
        (tmp_path / name).mkdir()

    def shown(tiles: dict[str, Tiles]) -> list[str]:
        add_to_sheet(tiles, "title", tmp_path)
        return [row.name for row in read_rows(tmp_path / SHEET_FILE_NAME)]

    assert shown({"a": red, "gone": red}) == ["a", "gone"]
    (tmp_path / "gone").rmdir()
    assert shown({"b": green}) == ["b", "a"]
    assert shown({"a": green}) == ["a", "b"]
    pixels: np.ndarray = oiio.ImageBuf(str(tmp_path / SHEET_FILE_NAME)).get_pixels(oiio.FLOAT)
    assert (len(places(pixels, "meta")), len(places(pixels, "reference"))) == (2 * TILE_PX**2, 0)
    first = {f"n{i}": red for i in range(MAX_SHEET_ROWS - 1)}
    for name in first:
        (tmp_path / name).mkdir()
    assert shown(first) == [*first, "a"]
    for content in (b"", b"\x89PNG", (tmp_path / SHEET_FILE_NAME).read_bytes()[:-400]):
        (tmp_path / SHEET_FILE_NAME).write_bytes(content)
        assert shown({"c": red}) == ["c"]
    sheet([red], tmp_path / SHEET_FILE_NAME)
    assert read_rows(tmp_path / SHEET_FILE_NAME) == []
    for marks in ("[]", '[["a", 0, 99999]]', '[["a", -1, 3]]', "[[1]]", "{", "3", '[["a", "x", 3]]'):
        texts = PngInfo()
        texts.add_text(ROW_MARKS_KEY, marks)
        Image.new("RGB", (9, 9)).save(tmp_path / SHEET_FILE_NAME, pnginfo=texts)
        assert read_rows(tmp_path / SHEET_FILE_NAME) == [], marks


def test_umlauts_are_drawn(tmp_path: Path) -> None:
    """A letter that a font lacks is a box, the same for all."""
    tasks = [Tiles({"meta": plain("meta")}, name) for name in "üßÉ"]
    drawn = [sheet([task], tmp_path / "sheet.png") for task in tasks]
    assert not (drawn[0] == drawn[1]).all()
    assert not (drawn[1] == drawn[2]).all()
