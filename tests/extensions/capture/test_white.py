"""White balance by the marker sheet's paper: gray under a warm light comes back gray."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.extensions.capture.marker_photos import take, tilted  # isort: skip

from data_tools.readers.image_files import read_pixels
from metapp.appearance.colorimetry import colour_difference, colour_science
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.extensions.capture.markers.sighting import find_sheet
from metapp.extensions.capture.markers.white import adaptation, paper_colour

pytestmark = pytest.mark.filterwarnings("ignore:Aligning")
CAMERAS = {"a": tilted(0, distance=26, height=900, width=1200), "b": tilted(25, 60, height=900, width=1200)}


@pytest.fixture(scope="module")
def warm() -> np.ndarray:
    """A Planckian radiator of 3000 K, linear RGB [3], by its spectrum; 1 at most, so that nothing is clipped."""
    colour = colour_science()
    spectrum = colour.sd_blackbody(3000, colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].shape)
    rgb: np.ndarray = colour.XYZ_to_RGB(colour.sd_to_XYZ(spectrum), "sRGB")
    return rgb / rgb.max()


def linear(path: Path) -> np.ndarray:
    """A picture in linear light [H W, 3]."""
    values = torch.from_numpy(read_pixels(path).values.reshape(-1, 3)).double() / 255
    return srgb_to_linear(values).numpy()


def chroma(colours: np.ndarray) -> np.ndarray:
    """How far red and green chromaticities [N, 2] are from gray's."""
    return colours[:, :2] / colours.sum(-1, keepdims=True) - 1 / 3


def test_gray_under_3000_kelvin_comes_back_gray_and_under_d65_is_unchanged(metapp: Callable, warm: np.ndarray) -> None:
    for name, camera in CAMERAS.items():
        take(Path("warm") / f"{name}.jpg", camera, light=0.9 * warm, noise=0.01)
        take(Path("neutral") / f"{name}.jpg", camera, light=np.full(3, 0.9), noise=0.01)
    pictures = {}
    for light in ("warm", "neutral"):
        for words in ((), ("--white",)):
            done = metapp("data", "rectify", light, "--out", f"{light}{len(words)}", *words, "--json")
            factors = [photo["white_factors"] for photo in done.done["photos"]]
            if not words:
                assert factors == [None, None]
                assert "white" not in done.err.splitlines()[0]
                continue
            expected = 1 / warm if light == "warm" else np.ones(3)
            for line, found in zip(done.err.splitlines(), factors, strict=False):
                np.testing.assert_allclose(found, expected, rtol=0.02)
                assert line.endswith("white x " + ", ".join(f"{factor:.2f}" for factor in found))
        for number in range(2):
            pictures[light, number] = [linear(Path(f"{light}{white}") / f"{number:02}.png") for white in range(2)]
    for number in range(2):
        before, after = pictures["warm", number]
        assert abs(chroma(before).mean(0)).max() > 0.2
        assert abs(chroma(after).mean(0)).max() < 0.01
        gray, same = pictures["neutral", number]
        assert abs(same - gray).max() < 0.012
        np.testing.assert_allclose(after.mean(0), gray.mean(0), rtol=0.02)


def test_colours_under_3000_kelvin_come_near_those_in_d65() -> None:
    """ColorChecker's: CIE 2000 colour differences, on average, are less than of channels scaled one by one."""
    colour = colour_science()
    shape = colour.SpectralShape(380, 780, 5)
    charts = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    reflectance = np.stack([np.ones(81), *(each.copy().align(shape).values for each in charts)])
    lights = (colour.sd_blackbody(3000, shape), colour.SDS_ILLUMINANTS["D65"])
    warm, day = (
        colour.XYZ_to_RGB(colour.msds_to_XYZ(reflectance, None, light, method="Integration", shape=shape) / 100, "sRGB")
        for light in lights
    )
    warm = (warm / warm[0].max()).clip(0)
    paper = warm[0]
    adapted, scaled = np.minimum(warm, paper) @ adaptation(paper).T, warm / paper
    off = [float(colour_difference(shown(each), shown(day)).mean()) for each in (warm, scaled, adapted)]
    assert off[0] > 15
    assert off[2] < 3
    assert off[2] < 0.9 * off[1]


def shown(values: np.ndarray) -> np.ndarray:
    """Display values of linear light."""
    return linear_to_srgb(torch.from_numpy(values.clip(0, 1))).numpy()


def test_paper_that_is_clipped_or_dark_is_said_in_one_line(metapp: Callable, warm: np.ndarray) -> None:
    for name, camera in CAMERAS.items():
        take(Path("bright") / f"{name}.jpg", camera, light=2 * warm)
        take(Path("dark") / f"{name}.png", camera, light=0.05 * warm)
    for folder, words in (
        ("bright", "clipped"),
        ("dark", "too dark"),
    ):
        assert len(metapp("data", "rectify", folder, "--out", f"{folder}-as-is", "--json").done["photos"]) == 2
        refusal = metapp("data", "rectify", folder, "--out", "leaf", "--white").refusal
        assert f"% of the sheet's paper is {words} for --white" in refusal
        assert not Path("leaf").exists()


def test_highlights_that_are_clipped_are_white(warm: np.ndarray, tmp_path: Path) -> None:
    path = take(tmp_path / "a.png", CAMERAS["a"], light=0.9 * warm)
    paper = paper_colour(read_pixels(path), find_sheet(path))
    bright = np.minimum(np.outer([0.5, 1, 2, 5, 9], paper), 1)  # clipped by the sensor
    balanced = np.minimum(bright, paper) @ adaptation(paper).T
    np.testing.assert_allclose(balanced, np.array([[0.5], [1], [1], [1], [1]]) * np.ones(3), atol=2e-3)
