"""Colour differences of published pairs, and sRGB as the standards have it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from metapp.appearance.colorimetry import colour_difference, colour_science
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear

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


def test_colour_differences_are_those_of_the_published_pairs() -> None:
    """Also as display values in D65, but for two pairs that lie at a jump; black and white differ by 100."""
    colour, table = colour_science(), np.array(SHARMA.split(), float).reshape(-1, 7)
    np.testing.assert_allclose(colour.delta_E(table[:, :3], table[:, 3:6], method="CIE 2000"), table[:, 6], atol=1e-4)
    table = np.delete(table, (3, 4), 0)
    one, other = (colour.XYZ_to_sRGB(colour.Lab_to_XYZ(table[:, at : at + 3])).reshape(2, 5, 3) for at in (0, 3))
    np.testing.assert_allclose(colour_difference(one, other), table[:, 6].reshape(2, 5), atol=1e-3)
    assert colour_difference(np.ones((1, 3)), np.zeros((1, 3))) == pytest.approx(100, abs=1e-3)


def test_srgb_of_tensors_is_that_of_colour_science() -> None:
    """Its transfer functions of IEC 61966-2-1, though it takes longer to import than a fit takes."""
    values, colour = np.linspace(0, 1, 1001), colour_science()
    pairs = ((srgb_to_linear, colour.models.eotf_sRGB), (linear_to_srgb, colour.models.eotf_inverse_sRGB))
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours(torch.from_numpy(values)).numpy(), theirs(values), rtol=1e-7, atol=1e-9)
