"""The line about dents and bumps, which one photograph cannot tell apart: printed where both look different."""

import pytest
import torch

from metapp.appearance.flash import relighting_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.surface import photograph_maps, scale_relief
from metapp.appearance.svbrdf_maps import Maps, mean_tilt_degrees
from metapp.cli.fit_output import VISIBLE_TILT_DEGREES, relief_lines
from metapp.runs.fit import Fit
from tests.cli.messages import says
from tests.kept_fits import fit_of

SIDE = 48  # px
VISIBLE = 0.02  # of display values, the mean of pictures under three lights
REMEDY = "metapp data rectify"  # what tells dents from bumps


def material(seed: int) -> Maps:
    """Draw a plain material with a relief of some power spectrum."""
    rng = torch.Generator().manual_seed(seed)
    frequency = torch.fft.fftfreq(SIDE) * SIDE
    falloff = torch.hypot(frequency[:, None], frequency[None]).clamp_min(1) ** -float(
        1 + 2 * torch.rand(1, generator=rng)
    )
    height = torch.fft.ifft2(torch.fft.fft2(torch.randn(SIDE, SIDE, generator=rng)) * falloff).real
    diffuse, rough = 0.1 + 0.6 * torch.rand(3, 1, 1, generator=rng), 0.2 + 0.7 * torch.rand(1, 1, 1, generator=rng)
    normal = normal_from_height((height / height.std())[None, None], 0.02)[0]
    plane = torch.ones(1, SIDE, SIDE)
    return Maps(diffuse * plane, 0.04 * plane, rough * plane, normal)


def tilted(maps: Maps, degrees: float) -> Maps:
    """Scale the slopes of maps to a mean tilt."""
    low, high = 1e-3, 1e3
    for _ in range(40):
        factor = (low * high) ** 0.5
        low, high = (factor, high) if mean_tilt_degrees(scale_relief(maps, factor).normal) < degrees else (low, factor)
    return scale_relief(maps, low)


def difference_of_readings(maps: Maps) -> float:
    """Return the mean difference of display values of a relief and of its inverse under other lights."""
    pairs = [
        (photograph_maps(maps, *at), photograph_maps(scale_relief(maps, -1.0), *at))
        for at in relighting_positions().values()
    ]
    return sum(float((relief - inverse).abs().mean()) for relief, inverse in pairs) / len(pairs)


def fit_of_tilt(degrees: float, **counts: int) -> Fit:
    """Return the record of a fit whose normals have a mean tilt."""
    return fit_of("wall", error=None, counts=counts, figures={"mean_tilt_degrees": degrees})


@pytest.mark.parametrize("seed", range(20, 40))  # the threshold was chosen on 0 to 19
@pytest.mark.parametrize(("times", "is_said"), [(2.0, True), (1 / 3, False)])
def test_dents_and_bumps_cause_a_line_where_they_look_different(seed: int, times: float, is_said: bool) -> None:
    maps = tilted(material(seed), times * VISIBLE_TILT_DEGREES)
    assert (difference_of_readings(maps) > VISIBLE) is is_said
    (line,) = relief_lines([fit_of_tilt(mean_tilt_degrees(maps.normal))])
    assert (REMEDY in line) is is_said


def test_each_run_prints_one_line_about_dents() -> None:
    steep, flat, several = fit_of_tilt(9.0), fit_of_tilt(0.4), fit_of_tilt(9.0, photos=5)
    assert relief_lines([fit_of("gold")]) == []
    for fits, facts, is_doubtful in (
        ([flat] * 3, ("0.4 degrees", "median of 3", "up to 0.4"), False),
        ([flat, flat, steep], ("0.4 degrees", "median of 3", "up to 9.0"), True),
        ([several], ("9.0 degrees",), False),
    ):
        (line,) = relief_lines(fits)
        assert says(line, *facts)
        assert (REMEDY in line) == is_doubtful
    assert REMEDY not in relief_lines([several, flat], changed=True)[0]
