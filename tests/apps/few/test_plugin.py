"""Mitsuba's plugin on a fit by the model for few samples: it evaluates as metapp does."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Generator

from metapp.appearance.geometry import directions_to_full_rusinkiewicz
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK
from tests.bsdfs import interactions_from, mirrored_pairs
from tests.needs_mitsuba import needs_mitsuba


@needs_mitsuba
@pytest.mark.long
def test_plugin_evaluates_as_metapp_does(mi: Any, tmp_path: Path) -> None:
    theta = {key: value[0].clone() for key, value in FEW_NETWORK.init(Generator().manual_seed(0), 1).items()}
    theta["last"][0] = 0.3 * torch.randn(theta["last"].shape[1], generator=Generator().manual_seed(1))
    save_file(theta, tmp_path / "few.safetensors")
    bsdf = mi.load_dict({"type": "neural_brdf", "filename": str(tmp_path / "few.safetensors")})
    light, viewer = mirrored_pairs(20_000)
    interaction = interactions_from(mi, viewer, 20_000)
    value = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(light)))
    angles = directions_to_full_rusinkiewicz(
        *(torch.from_numpy(directions.T).double() for directions in (light, viewer))
    )
    expected = FEW_NETWORK.evaluate({key: value.double() for key, value in theta.items()}, angles).numpy().T * light[2]
    error = np.max(np.abs(value - expected) / (1 + np.abs(expected)), axis=0)
    # in the last degree before the horizon directions of single precision say no more about their angles
    assert error[np.minimum(light[2], viewer[2]) > 0.02].max() < 1e-5
    assert error.max() < 5e-4  # it divides by both cosines
    assert expected.max() > 1
