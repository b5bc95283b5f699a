"""Scenes for Mitsuba: they load, and light comes back from them as from the maps that were fitted."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb, radiance_to_display
from metapp.appearance.flash import (
    camera_position,
    evaluate_brdf,
    relighting_positions,
    render_maps,
    texel_positions,
)
from metapp.extensions.assets import mitsuba_surfaces
from tests.needs_mitsuba import needs_mitsuba
from tests.surfaces import PROVENANCE, rock_surface

pytestmark = needs_mitsuba
SIDE = 32


@pytest.fixture(scope="module")
def mi() -> Any:
    from metapp.rendering.variant import load_mitsuba

    module = load_mitsuba()
    from metapp.extensions.mitsuba_bsdfs.neural_svbrdf import register_neural_svbrdf

    register_neural_svbrdf()
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "rock"
    mitsuba_surfaces.write_mitsuba(rock_surface(SIDE), path, PROVENANCE)
    return path


def texels(mi: Any, scene: Any) -> Any:
    """What rays from straight above hit in the centres of all texels, row by row."""
    x, y = texel_positions(SIDE, SIDE).flatten(1).numpy()
    origin = mi.Point3f(mi.Float(x), mi.Float(y), 2.0)
    return scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))


def plane(values: Any) -> Tensor:
    return torch.from_numpy(np.array(values)).reshape(-1, SIDE, SIDE)


def test_every_texel_reflects_as_it_was_fitted(mi: Any, folder: Path) -> None:
    scene = mi.load_file(str(folder / "rock.xml"))  # its BSDFs live as long as it
    si = texels(mi, scene)
    for towards in ((0.3, 0.4, 0.866), (-0.6, 0.1, 0.79), (0.0, 0.0, 1.0)):
        wo = torch.tensor(towards) / torch.tensor(towards).norm()
        found = plane(si.bsdf().eval(mi.BSDFContext(), si, mi.Vector3f(*wo.tolist())))
        maps, wi = rock_surface(SIDE).maps, torch.tensor([0.0, 0.0, 1.0])
        every = [direction[:, None, None].expand(-1, SIDE, SIDE) for direction in (wo, wi)]
        cosine = (every[0] * maps.normal).sum(0).clamp_min(0)
        expected = evaluate_brdf(maps, *every) * cosine
        # a step of 16 bits turns a normal by up to 5e-5, of a lobe whose alpha is 0.02
        assert ((found - expected).abs() < 2e-3 * expected + 1e-4).all()
    texture = mi.load_dict({"type": "bitmap", "filename": str(folder / "rock_specular.png")})
    f0 = plane(texture.eval(si)).clamp(0, 1)
    assert (linear_to_srgb(f0) - linear_to_srgb(rock_surface(SIDE).maps.specular)).abs().max() < 1 / 255


def test_the_scenes_show_what_our_renderer_shows(mi: Any, folder: Path) -> None:
    """The scene without the plugin looks nearly the same: F0 of another hue than the diffuse colour is lost."""
    text = (folder / "rock_builtin.xml").read_text(encoding="utf-8")
    assert "principled" in text
    assert "neural_svbrdf" not in text
    result = [mi.render(mi.load_file(str(folder / f"rock{suffix}.xml")), spp=256) for suffix in ("", "_builtin")]
    own, builtin = (radiance_to_display(torch.from_numpy(np.array(rendering)).movedim(-1, 0)) for rendering in result)
    lit = radiance_to_display(
        render_maps(
            rock_surface(SIDE).maps, texel_positions(SIDE, SIDE), relighting_positions()["left"][0], camera_position()
        )
    )
    assert (own - lit).abs().mean() < 0.02
    assert (own - builtin).abs().mean() < 0.12
