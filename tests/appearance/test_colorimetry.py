"""Colour differences: published pairs, and sRGB as the standards have it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from metapp.appearance.colorimetry import colour_difference, colour_science
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear

Array = NDArray[np.float64]

# L*, a*, b* of two colours and their difference: Sharma, Wu, Dalal 2005, table 1, where implementations often differ
SHARMA = """
50.0000   2.6772 -79.7751  50.0000   0.0000 -82.7485   2.0425
50.0000   2.8361 -74.0200  50.0000   0.0000 -82.7485   3.4412
50.0000   0.0000   0.0000  50.0000  -1.0000   2.0000   2.3669
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0009   7.1792
50.0000   2.4900  -0.0010  50.0000  -2.4900   0.0011   7.2195
50.0000   2.5000   0.0000  73.0000  25.0000 -18.0000  27.1492
50.0000   2.5000   0.0000  58.0000  24.0000  15.0000  19.4535
60.2574 -34.0099  36.2677  60.4626 -34.1751  39.4387   1.2644
61.2901   3.7196  -5.3901  61.4292   2.2480  -4.9620   1.8731
22.7233  20.0904 -46.6940  23.0331  14.9730 -42.5619   2.0373
90.8027  -2.0831   1.4410  91.1528  -1.6435   0.0447   1.4441
2.0776    0.0795  -1.1350   0.9033  -0.0636  -0.5514   0.9082
"""


def ciede2000(one: Array, other: Array) -> Array:
    """Sharma's equations, of L*, a*, b* [N, 3]."""
    (l1, a1, b1), (l2, a2, b2) = one.T, other.T
    mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(mean**7 / (mean**7 + 25.0**7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    gray = c1 * c2 == 0
    step = np.where(gray, 0, (h2 - h1 + 180) % 360 - 180)
    hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(step / 2))
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    middle = np.where(gray, h1 + h2, np.where(abs(h1 - h2) <= 180, (h1 + h2) / 2, (h1 + h2 + 360) / 2 % 360))
    t = 1 - 0.17 * cosine(middle - 30) + 0.24 * cosine(2 * middle)
    t += 0.32 * cosine(3 * middle + 6) - 0.2 * cosine(4 * middle - 63)
    turn = 60 * np.exp(-(((middle - 275) / 25) ** 2))
    rotation = -2 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(turn))
    of_lightness = (l2 - l1) / (1 + 0.015 * (lightness - 50) ** 2 / np.sqrt(20 + (lightness - 50) ** 2))
    of_chroma, of_hue = (c2 - c1) / (1 + 0.045 * chroma), hue / (1 + 0.015 * chroma * t)
    result: Array = np.sqrt(of_lightness**2 + of_chroma**2 + of_hue**2 + rotation * of_chroma * of_hue)
    return result


def cosine(degrees: Array) -> Array:
    return np.cos(np.radians(degrees))


def lab(display: Array) -> Array:
    """Of sRGB [N, 3] by IEC 61966-2-1 and CIE 15, D65."""
    linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    matrix = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = linear @ np.transpose(matrix) / (0.9505, 1.0, 1.089)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], 1)


def test_colour_differences_are_those_of_the_published_pairs() -> None:
    """The equations above and colour-science on Sharma's pairs; the wrapper as the equations on sRGB."""
    table = np.array(SHARMA.split(), float).reshape(-1, 7)
    one, other, expected = table[:, :3], table[:, 3:6], table[:, 6]
    np.testing.assert_allclose(ciede2000(one, other), expected, atol=1e-4)
    np.testing.assert_allclose(colour_science().delta_E(one, other, method="CIE 2000"), expected, atol=1e-4)
    pictures, references = np.random.default_rng(0).random((2, 500, 3))
    found = colour_difference(pictures.reshape(20, 25, 3), references.reshape(20, 25, 3))
    assert found.shape == (20, 25)
    np.testing.assert_allclose(found.ravel(), ciede2000(lab(pictures), lab(references)), atol=0.02)


def test_black_and_white_differ_by_100_and_equal_colours_by_0() -> None:
    white = np.ones((1, 3))
    assert colour_difference(white, 0 * white) == pytest.approx(100, abs=1e-3)
    assert (colour_difference(white, white), colour_difference(0.3 * white, 0.3 * white)) == (0, 0)


def test_srgb_of_tensors_is_that_of_colour_science() -> None:
    """Its transfer functions of IEC 61966-2-1, though it takes longer to import than a fit takes."""
    values, colour = np.linspace(0, 1, 1001), colour_science()
    pairs = ((srgb_to_linear, colour.models.eotf_sRGB), (linear_to_srgb, colour.models.eotf_inverse_sRGB))
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours(torch.from_numpy(values)).numpy(), theirs(values), rtol=1e-7, atol=1e-9)
