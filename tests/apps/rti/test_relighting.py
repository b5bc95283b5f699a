"""Fits that are relit: as large as their photographs, and as the photographs themselves under their own lamps."""

import numpy as np
import pytest
import torch

import metapp
from metapp.appearance.colour import srgb_to_linear
from metapp.apps.svbrdf_nonstationary.rti.recipe import RTI
from tests.apps.rti.scenes import lit_task
from tests.recipe_apps import asset_of


def test_photographs_are_predicted_under_their_own_lamps() -> None:
    task = lit_task(side=24, lamps=30, specular=0.04)
    theta = {name: value[0] for name, value in RTI.app.init(torch.Generator().manual_seed(0), 1).items()}
    surface = asset_of(RTI.app, theta, task)
    pictures = surface.lit_photos.relight(task.data["lamps"])
    photos = srgb_to_linear(task.data["lit"].float() / 255)
    assert float((pictures - photos).abs().mean()) < 0.01
    shaded = surface.relight(task.data["lamps"])
    assert float((shaded - photos).abs().mean()) < 0.05


def test_fits_of_maps_are_relit_by_their_maps() -> None:
    maps = {"diffuse": np.full((64, 64, 3), 0.5), "normal": np.zeros((64, 64, 3)), "roughness": np.full((64, 64), 0.5)}
    maps["normal"][..., 2] = 1
    fit = metapp.fit("svbrdf_nonstationary", maps, paradigm="meta", recipe="quick")
    high, low = fit.relight(np.array([[0.0, 0, 1], [0.8, 0, 0.6]]))
    assert high.shape[-1] == 3
    assert 0.4 < float(low.mean() / high.mean()) < 0.65  # the cosine is 0.6, and the highlight is seen from above
    with pytest.raises(ValueError, match="directions"):
        fit.relight([[0, 0, 2]])


def test_other_applications_are_not_relit() -> None:
    fit = metapp.fit("brdf", lambda wi, wo: np.full((len(wi), 3), 0.1))
    with pytest.raises(ValueError, match="expected one of svbrdf_nonstationary"):
        fit.relight([[0.0, 0, 1]])
