"""Borders of photographs that show nothing: frames, and the corners beside pictures that were turned or straightened.

A border is cut off where it is surely none of the picture. It has one colour, ends at a sharp edge, and its colour does
not return in lines or areas of the picture, as the joints of a wall do. Maps of materials are never cut, since they
must stay aligned.
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from data_tools.readers.colours import Array, Floats, integers_to_unit_range
from data_tools.readers.image_files import Pixels

_MIN_FRAME_PX = 2  # width of a frame
_MIN_PART_PX, _MIN_PART_SHARE = 32, 0.25  # each side of the part that is left, px and share of the picture's side
# deviations of 255 in a frame: their median in the outermost line, and of all but outliers
_MEDIAN_LEVELS, _NOISE_LEVELS = 6, 16
_MIN_FRAME_SHARE, _MIN_RINGING_SHARE = 0.95, 0.75  # share of a line within _NOISE_LEVELS: in a frame, near its edge
_RINGING_PX = 8  # rows by which JPEG, whose blocks have as many, and scaling blur the edge of a frame
_BLUR_PX = 2  # lines of mixed colours inside a frame that was compressed or scaled
_MIN_EDGE_SHARE, _MIN_EDGE_LEVELS = 0.5, 16  # share of the line inside a frame that differs from it, and by how much
_ROWS_AT_ONCE = 64  # rows whose levels are held at a time
_MIN_RECURRING_SHARE = 0.9  # share of a line that has the colour of the frame, as of a joint
_MIN_OPAQUE_ALPHA = 0.98
_MIN_RECTANGLE_SHARE = 0.4  # of the visible area: a square turned by 45 degrees holds one of 0.5
_GRID_CELLS = 512  # cells of the longer side in which the largest rectangle is looked for
_CORNER_LEVELS, _CORNER_EDGE_LEVELS = 20, 32  # deviations of 255 in a corner, and beyond its edge
_MIN_CORNER_SHARE = 0.02  # extent of an empty corner along either side of the picture
_CORNER_AREAS = (0.6, 1.4)  # area of an empty corner over that of a triangle of its extents
_MIN_CORNERS = 2  # number of empty corners of a picture that was turned or straightened
_MAX_RECURRING_AREA = 0.02  # share of the picture that has the colour of empty corners


class Part(NamedTuple):
    """A rectangle of a picture, in px: rows top to bottom, columns left to right, ends exclusive."""

    top: int
    bottom: int
    left: int
    right: int

    def crop(self, values: Array) -> Array:
        """Return the values [H, W, ...] inside the rectangle."""
        return values[self.top : self.bottom, self.left : self.right]


def crop_borders(whole: Pixels, name: str, *, is_cut_out: bool = False) -> Pixels:
    """Cut off what shows nothing at the borders of a photograph, and warn of it.

    A frame was put around the photograph, so that the field of view stays; a picture inside empty corners is narrower.

    Args:
        whole: the photograph.
        name: its name in the warning.
        is_cut_out: whether transparent and empty corners are kept, since they surround an object such as a ball.
    """
    pixels, causes = whole, list[str]()
    if not is_cut_out:
        pixels = _crop_corners(pixels, ~_opaque(pixels.values))
        causes += ["transparent borders"] if pixels is not whole else []
    part, colours = find_frame(pixels.values)
    if colours:
        pixels = pixels._replace(values=part.crop(pixels.values))
        causes.append(f"a frame ({', '.join(dict.fromkeys(map(_colour_name, colours)))})")
    if not is_cut_out:
        inside = _crop_corners(pixels, find_empty_corners(pixels.values))
        causes += ["empty corners"] if inside is not pixels else []
        pixels = inside
    if causes:
        (height, width), (inner_height, inner_width) = whole.values.shape[:2], pixels.values.shape[:2]
        warnings.warn(
            f"{name}: {width:,} x {height:,} px with {' and '.join(causes)}; the border is cut off, the picture inside "
            f"has {inner_width:,} x {inner_height:,} px.",
            stacklevel=2,
        )
    return pixels


def find_frame(values: Array) -> tuple[Part, list[tuple[int, ...]]]:
    """Find the picture inside a frame, which may be on one side alone, and differ from side to side.

    Args:
        values: the values of a picture, [H, W, 3 or 4].

    Returns:
        The part inside the frame, and the colours of the frame, each of three levels of 255; the whole picture and []
        if it has none.
    """
    height, width = values.shape[:2]
    part, colours, is_changed = Part(0, height, 0, width), list[tuple[int, ...]](), True
    while is_changed:  # a frame around a frame, and sides of several colours, need several rounds
        is_changed = False
        for side in Part._fields:
            frame_px, colour = _frame_of_side(part.crop(values), side)
            if frame_px:
                sign = -1 if side in ("bottom", "right") else 1
                part, is_changed = part._replace(**{side: getattr(part, side) + sign * frame_px}), True
                colours.append(colour)
    inside = part.crop(values)
    is_too_small = any(
        length < max(_MIN_PART_PX, _MIN_PART_SHARE * whole)
        for length, whole in zip(inside.shape[:2], (height, width), strict=True)
    )
    if is_too_small or any(_recurs(inside, colour) for colour in colours):
        return Part(0, height, 0, width), []
    return part, colours


def _frame_of_side(values: Array, side: str) -> tuple[int, tuple[int, ...]]:
    """Return the width in px of the frame at a side of a picture, 0 if there is none, and its colour."""
    lines = {"top": values, "bottom": values[::-1], "left": values.swapaxes(0, 1)}
    ordered = lines[side] if side in lines else values.swapaxes(0, 1)[::-1]
    if len(ordered) <= _MIN_FRAME_PX:
        return 0, ()
    colour = np.median(_levels(ordered[0]), 0)
    shares, medians = list[float](), list[float]()
    for line in ordered:
        deviation = np.abs(_levels(line) - colour).max(-1)
        shares.append(float((deviation <= _NOISE_LEVELS).mean()))
        medians.append(float(np.median(deviation)))
        if len(shares) > 1 and shares[-2] < _MIN_RINGING_SHARE:  # this is the second line inside the frame
            break
        if len(shares) > _RINGING_PX and shares[-_RINGING_PX - 1] < _MIN_FRAME_SHARE:
            return 0, ()
    frame_px = next((row for row, share in enumerate(shares) if share < _MIN_RINGING_SHARE), len(ordered))
    is_frame = frame_px >= _MIN_FRAME_PX and medians[0] <= _MEDIAN_LEVELS
    if not is_frame or min(shares[: max(_MIN_FRAME_PX, frame_px - _RINGING_PX)]) < _MIN_FRAME_SHARE:
        return 0, ()
    # a slope is no edge, so what is just inside is compared with what is just outside
    is_edge = len(shares) > frame_px + 1 and medians[frame_px + 1] - medians[frame_px - 2] >= _MIN_EDGE_LEVELS
    if not is_edge or shares[frame_px + 1] > 1 - _MIN_EDGE_SHARE:
        return 0, ()
    is_exact = max(medians[:frame_px]) == 0 and min(shares[:frame_px]) == 1
    return frame_px + (0 if is_exact else _BLUR_PX), tuple(int(level) for level in colour.round())


def _recurs(values: Array, colour: tuple[int, ...]) -> bool:
    """Tell whether a picture has rows or columns of a colour, as the joints of a wall are."""
    row_share, column_counts = 0.0, np.zeros(values.shape[1])
    for row in range(0, len(values), _ROWS_AT_ONCE):
        is_near = np.abs(_levels(values[row : row + _ROWS_AT_ONCE]) - np.array(colour)).max(-1) <= _NOISE_LEVELS
        row_share = max(row_share, float(is_near.mean(1).max()))
        column_counts += is_near.sum(0)
    return row_share >= _MIN_RECURRING_SHARE or bool(column_counts.max() >= _MIN_RECURRING_SHARE * len(values))


def _levels(values: Array) -> Floats:
    """Return colours [..., 3] as levels in [0, 255]; floating-point values by a power of 1/2.2."""
    unit = integers_to_unit_range(values[..., :3])
    if values.dtype.kind == "f":
        unit = np.nan_to_num(unit).clip(0, 1) ** (1 / 2.2)
    return unit * 255


def _colour_name(colour: tuple[int, ...]) -> str:
    if min(colour) >= 255 - _NOISE_LEVELS:
        return "white"
    return "black" if max(colour) <= _NOISE_LEVELS else f"sRGB {' '.join(map(str, colour))}"


def _opaque(values: Array) -> Array:
    """Return which px of a picture are opaque, bool [H, W]."""
    if values.shape[-1] < 4:
        return np.ones(values.shape[:2], bool)
    return integers_to_unit_range(values[..., 3]) >= _MIN_OPAQUE_ALPHA


def find_empty_corners(values: Array) -> Array:
    """Find the corners of one colour that turning or straightening a picture leaves, bool [H, W].

    Two corners or more are triangles of one colour, with a sharp edge.

    Args:
        values: the values of a picture, [H, W, 3 or 4].
    """
    height, width = values.shape[:2]
    step = math.ceil(max(height, width) / (2 * _GRID_CELLS))
    levels = _levels(values[::step, ::step])
    is_empty, is_near, count = np.zeros(levels.shape[:2], bool), np.zeros(levels.shape[:2], bool), 0
    for row, column in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        if not _is_even(levels[:, column][:: -1 if row else 1]) or not _is_even(levels[row][:: -1 if column else 1]):
            continue  # which most pictures do, and saves the time of the search
        deviation = np.abs(levels - levels[row, column]).max(-1)
        # opened, since a line of one px along the border may join two corners
        near_corner = ndimage.binary_opening(deviation <= _CORNER_LEVELS, np.ones((3, 3)))
        labels, _ = ndimage.label(near_corner)
        corner = near_corner & (labels == labels[row, column])
        if _is_empty_triangle(corner, deviation, row, column):
            is_empty, is_near, count = is_empty | corner, is_near | near_corner, count + 1
    if count < _MIN_CORNERS or (is_near & ~is_empty).mean() > _MAX_RECURRING_AREA:
        return np.zeros((height, width), bool)
    # by two cells wider, for the px of a mixed colour at the edge
    grown = ndimage.binary_dilation(is_empty, np.ones((3, 3)), 2)
    wide: Array = grown.repeat(step, 0).repeat(step, 1)
    return wide[:height, :width]


def _is_even(line: Floats) -> bool:
    """Tell whether levels [N, 3] along a border have one colour over the least extent of an empty corner."""
    start = line[: max(2, math.ceil(_MIN_CORNER_SHARE * len(line)))]
    return bool(np.abs(start - start[0]).max() <= _CORNER_LEVELS)


def _is_empty_triangle(corner: Array, deviation: Array, row: int, column: int) -> bool:
    """Tell whether an area at a corner of a picture is a triangle with a sharp edge.

    Args:
        corner: the area, bool [H, W].
        deviation: deviations of all px from the colour of the corner, levels of 255 [H, W].
        row: the corner's row, 0 or -1.
        column: the corner's column, 0 or -1.
    """
    height, width = corner.shape
    down, across = int(corner[:, column].sum()), int(corner[row].sum())
    if down < max(2, _MIN_CORNER_SHARE * height) or across < max(2, _MIN_CORNER_SHARE * width):
        return False
    low, high = _CORNER_AREAS
    if not low <= 2 * corner.sum() / (down * across) <= high:
        return False
    near_edge = ndimage.binary_dilation(corner, np.ones((3, 3)), 2)
    beyond_edge = ndimage.binary_dilation(near_edge, np.ones((3, 3))) & ~near_edge
    return bool(beyond_edge.any() and (deviation[beyond_edge] > _CORNER_EDGE_LEVELS).mean() >= _MIN_EDGE_SHARE)


def _crop_corners(pixels: Pixels, is_empty: Array) -> Pixels:
    """Return the largest rectangle without empty px, or all of a picture that has none or is not mostly one rectangle.

    Args:
        pixels: the picture.
        is_empty: its empty px, bool [H, W].
    """
    if not is_empty.any() or is_empty.all():
        return pixels
    part = largest_rectangle(~is_empty)
    height, width = part.bottom - part.top, part.right - part.left
    visible_px = int((~is_empty).sum())
    if min(height, width) < _MIN_PART_PX or height * width < _MIN_RECTANGLE_SHARE * visible_px:
        return pixels
    narrowing = math.sqrt(visible_px / (height * width))  # of a picture of the same ratio of sides
    # what is visible is the whole photograph, whatever size EXIF states
    lens = pixels.lens._replace(focal_mm=pixels.lens.focal_mm * narrowing, whole_px=(0, 0))
    return pixels._replace(values=part.crop(pixels.values)[..., :3], lens=lens)


def largest_rectangle(inside: Array) -> Part:
    """Return the largest rectangle of true values, to within 1/512 of the longer side.

    Args:
        inside: bool [H, W].

    >>> largest_rectangle(np.array([[1, 1, 0], [1, 1, 0], [0, 1, 1]], bool))
    Part(top=0, bottom=2, left=0, right=2)
    """
    step = math.ceil(max(inside.shape) / _GRID_CELLS)
    starts = [np.arange(0, length, step) for length in inside.shape]
    cells = np.logical_and.reduceat(np.logical_and.reduceat(inside, starts[0], 0), starts[1], 1)
    best, best_area, heights = Part(0, 0, 0, 0), 0, np.zeros(cells.shape[1] + 1, int)
    for row, line in enumerate(cells):
        heights[:-1] = (heights[:-1] + 1) * line  # of the columns of true cells that end in this row; the last is 0
        open_columns: list[tuple[int, int]] = []  # left end and height of rectangles that may still grow to the right
        for column, column_height in enumerate(heights.tolist()):
            left = column
            while open_columns and open_columns[-1][1] >= column_height:
                left, rectangle_height = open_columns.pop()
                area = rectangle_height * (column - left)
                if area > best_area:
                    best, best_area = Part(row + 1 - rectangle_height, row + 1, left, column), area
            open_columns.append((left, column_height))
    height, width = inside.shape
    return Part(best.top * step, min(height, best.bottom * step), best.left * step, min(width, best.right * step))
