"""Fits, tables and readers give the values of tests/golden/values.json, to rounding."""

import json
import os
from pathlib import Path

import pytest

from metapp.appearance.features import vgg_weights_path
from tests.golden.golden_values import PARTS

FILE = Path(__file__).with_name("values.json")
GOLDEN = json.loads(FILE.read_text(encoding="utf-8"))
VGG = vgg_weights_path()  # of the user: tests have a cache of their own
NEEDS_VGG = ("texture", "svbrdf_stationary", "read", "best")
OF_FITS = (
    "file brdf network.bsdf ",
    "file svbrdf_nonstationary diffuse.png ",
    "file transport ",
)  # or Mitsuba's samples
TAKES_SECONDS = ("transport", "read", "best")
ROUNDING = 1.5e-2  # of other CPUs and libraries, which learned steps amplify: up to 0.8 % of an error without AVX2


@pytest.mark.parametrize(
    "part", [pytest.param(part, marks=[pytest.mark.long] * (part in TAKES_SECONDS)) for part in PARTS]
)
def test_results_agree_with_golden_values(part: str, tmp_path: Path, cache: Path) -> None:
    if part in NEEDS_VGG:
        if not VGG.is_file():
            pytest.skip("the weights of VGG-16 are missing: metapp data vgg")
        os.link(VGG, cache / VGG.name)
    found = PARTS[part](tmp_path)
    golden = GOLDEN[part]
    assert list(found) == list(golden)
    for key, values in golden.items():
        exact = part == "read" and not key.startswith(OF_FITS)
        tolerance = 0.0 if key.endswith("shape") else 1e-4 if exact else ROUNDING
        scale = max(map(abs, values), default=0.0)
        assert found[key] == pytest.approx(values, rel=tolerance, abs=tolerance * scale), key
