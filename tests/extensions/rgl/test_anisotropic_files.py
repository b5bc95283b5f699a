"""RGL files of anisotropic BRDFs: Mitsuba's `measured` has their values, and draws by them, at any azimuth."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from metapp.appearance.geometry import angle_cosines, directions_to_four_angles
from metapp.appearance.reflection import microfacet_lobe
from metapp.extensions.rgl import rgl
from metapp.extensions.rgl.brdf_scene import write_brdf_scenes
from metapp.extensions.rgl.rgl import write_rgl
from metapp.extensions.rgl.tensor_file import write_tensor_file
from metapp.learning.task import Task
from tests import anisotropic
from tests.anisotropic import (
    APP,
    VIEWERS_DEGREES,
    brushed_reflectance,
    brushed_reflectance_at_angles,
    direction_at_angles,
    direction_at_degrees,
    random_directions,
)
from tests.bsdfs import interactions_from
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import asset_of

pytestmark = needs_mitsuba
RESOLUTION = 64  # of the tables of a file as the database has it


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files by what they are of: isotropic and anisotropic as they are written here, and as the database has them."""
    folder = tmp_path_factory.mktemp("files")
    paths = {name: folder / f"{name}.bsdf" for name in ("isotropic", "anisotropic", "database")}
    write_rgl(paths["isotropic"], glossy, "isotropic")
    write_rgl(paths["anisotropic"], brushed_reflectance_at_angles, "anisotropic", azimuths=True)
    write_as_the_database(paths["database"])
    return paths


def glossy(angles: Tensor) -> Tensor:
    """A GGX lobe on a diffuse body: [..., 3] in 1/sr."""
    lobe = microfacet_lobe(
        angle_cosines(angles.double()), 0.15, lambda cos: 0.04 + 0.96 * (1 - cos) ** 5 * torch.ones(3)
    )
    return (lobe + torch.tensor([0.1, 0.05, 0.02])).to(angles)


def write_as_the_database(path: Path) -> None:
    """A file of the layout of Dupuy and Jakob 2018: warped by visible normals, Jacobians, azimuths from -pi to 0.

    The material is the same whether it is turned by pi: so phi_i covers half a circle. What is stored is f cos theta of
    the light over D / (4 sigma), at places that a warp by `vndf` gives, which Mitsuba's own class evaluates here.
    """
    from metapp.rendering.variant import load_mitsuba

    mi = load_mitsuba()
    phi, theta = np.linspace(-math.pi, 0, 17), np.linspace(0, math.radians(88), 24)
    line = (np.arange(RESOLUTION) / (RESOLUTION - 1)).astype(np.float32)
    v, u = np.meshgrid(line, line, indexing="ij")
    half = direction_at_angles(u**2 * math.pi / 2, (2 * v - 1) * math.pi)
    viewers = direction_at_angles(theta[None], phi[:, None])
    spread = (half[..., 0] / 0.6) ** 2 + (half[..., 1] / 0.4) ** 2 + half[..., 2] ** 2
    density = (1 / spread**2).astype(np.float32)  # any will do that the warp and the values share
    seen = np.einsum("vuc,ptc->ptvu", half, viewers).clip(0)
    area = 2 * math.pi**2 * u * np.sqrt(1 - half[..., 2] ** 2)
    vndf = (density * seen * area + 1e-4).astype(np.float32)
    warp = mi.MarginalContinuous2D2(vndf, [phi.astype(np.float32).tolist(), theta.astype(np.float32).tolist()], True)
    rgb = np.zeros((len(phi), len(theta), 3, RESOLUTION, RESOLUTION), np.float32)
    places = mi.Point2f(u.ravel(), v.ravel())
    for i, j in np.ndindex(len(phi), len(theta)):
        at, _ = warp.sample(places, mi.Vector2f(float(phi[i]), float(theta[j])))
        at = np.array(at, dtype=np.float64)
        normal = direction_at_angles(at[0] ** 2 * math.pi / 2, (2 * at[1] - 1) * math.pi)
        viewer = viewers[i, j]
        light = 2 * (normal @ viewer)[:, None] * normal - viewer
        up = light[:, 2] > 1e-3
        safe = np.where(up[:, None], light, [0, 0, 1.0])
        pair = (torch.from_numpy(np.broadcast_to(vectors, safe.shape).copy()) for vectors in (safe, viewer))
        value = brushed_reflectance(*pair)
        distribution = bilinear(density, at)
        rgb[i, j] = (value.numpy() * (safe[:, 2] * up * 4 / distribution)[:, None]).T.reshape(3, RESOLUTION, RESOLUTION)
    write_tensor_file(
        path,
        {
            "description": np.frombuffer(b"brushed", np.uint8),
            "phi_i": phi.astype(np.float32),
            "theta_i": theta.astype(np.float32),
            "sigma": np.ones((4, 4), np.float32),
            "ndf": density,
            "vndf": vndf,
            "luminance": (rgb.mean(2) + 1e-3 * rgb.mean()).astype(np.float32),
            "rgb": rgb,
            "jacobian": np.ones(1, np.uint8),
        },
    )


def bilinear(table: NDArray[np.float32], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """A table [N (v), N (u)] at places (u, v), [2, n]."""
    places = np.clip(at * (RESOLUTION - 1), 0, RESOLUTION - 1 - 1e-6)
    (u, v), (s, t) = places.astype(int), places % 1
    lower, upper = ((1 - s) * table[v + i, u] + s * table[v + i, u + 1] for i in (0, 1))
    result: NDArray[np.float64] = (1 - t) * lower + t * upper
    return result


@pytest.fixture
def bsdf(mi: Any, files: dict[str, Path], request: pytest.FixtureRequest) -> Any:
    return mi.load_dict({"type": "measured", "filename": str(files[request.param])})


@pytest.mark.long
@pytest.mark.parametrize(("name", "least"), [("anisotropic", 0.02), ("database", 0.05)])
def test_files_read_back_as_the_material_they_were_made_of(files: dict[str, Path], name: str, least: float) -> None:
    assert rgl.is_anisotropic(files[name])
    wi, wo = (random_directions(4000, seed, 0.2) for seed in (1, 2))
    angles = directions_to_four_angles(wi, wo)
    found, expected = rgl.read_rgl(files[name])(angles), brushed_reflectance_at_angles(angles)
    assert float((found - expected).abs().mean() / expected.mean()) < least
    mirrored_angles = directions_to_four_angles(*(vectors * torch.tensor([1.0, -1.0, 1.0]) for vectors in (wi, wo)))
    difference, difference_from_mirrored = (
        float((torch.log(found + 0.01) - torch.log(brushed_reflectance_at_angles(compared) + 0.01)).abs().mean())
        for compared in (angles, mirrored_angles)
    )
    assert difference < 0.2 * difference_from_mirrored  # the file does not hold the mirror image


@pytest.mark.long
def test_anisotropic_files_are_refused_where_isotropic_ones_are_expected(files: dict[str, Path]) -> None:
    with pytest.raises(ValueError, match=r"anisotropic.bsdf: anisotropic, expected an isotropic measurement") as caught:
        rgl.read_rgl(files["anisotropic"])(torch.zeros(5, 3))
    assert "\n" not in str(caught.value)
    task = rgl.read_task(files["anisotropic"], samples=256)
    assert task.data["phi_h"].shape == (256,)


@pytest.mark.long
@pytest.mark.parametrize("bsdf", ["isotropic", "anisotropic", "database"], indirect=True)
@pytest.mark.parametrize("degrees", VIEWERS_DEGREES)
def test_drawn_directions_follow_the_values(mi: Any, bsdf: Any, degrees: tuple[float, float]) -> None:
    """Draws are counted in 12 x 6 cells of azimuth and height.

    No azimuth is flipped (pull request 1850 of Mitsuba 3).
    """
    count, viewer = 200_000, direction_at_degrees(degrees)
    numbers = np.random.default_rng(0).random((3, count)).astype(np.float32)
    drawn, weight = bsdf.sample(mi.BSDFContext(), interactions_from(mi, viewer, count), mi.Float(numbers[0]),
                                mi.Point2f(numbers[1:]))  # fmt: skip
    light, weight = np.array(drawn.wo), np.array(weight).mean(0)
    up = (light[2] > 0) & (np.array(drawn.pdf) > 0)
    found = cells(light, np.where(up, weight, 0)) / count
    uniform = np.random.default_rng(1).random((2, 400_000)).astype(np.float32)
    radius, phi = np.sqrt(1 - uniform[0] ** 2), 2 * math.pi * uniform[1]
    every = np.stack([radius * np.cos(phi), radius * np.sin(phi), uniform[0]])
    values = np.array(
        bsdf.eval(mi.BSDFContext(), interactions_from(mi, viewer, every.shape[1]), mi.Vector3f(every))
    ).mean(0)
    expected = cells(every, values) * 2 * math.pi / every.shape[1]
    assert abs(found - expected).sum() < 0.05 * expected.sum()
    assert abs(found - expected[::-1]).sum() > 0.2 * expected.sum() or degrees[1] in (0, 180)


def cells(light: NDArray[np.float32], weights: NDArray[np.float32]) -> NDArray[np.float64]:
    """Sums of weights by azimuth and squared height."""
    azimuth = np.arctan2(light[1], light[0])
    result: NDArray[np.float64] = np.histogram2d(azimuth, light[2] ** 2, bins=(12, 6), weights=weights,
                                                 range=((-math.pi, math.pi), (0, 1)))[0]  # fmt: skip
    return result


@pytest.mark.long
def test_exports_of_a_fit_are_anisotropic(mi: Any, tmp_path: Path) -> None:
    theta = anisotropic.solve_for_brushed()
    write_brdf_scenes(asset_of(APP, theta, Task("brushed", {})), tmp_path / "brushed", {})
    (source,), _ = rgl.find(tmp_path / "brushed")
    assert source.facts == {"anisotropic": True}
    angles = directions_to_four_angles(random_directions(3000, 1, 0.2), random_directions(3000, 2, 0.2)).float()
    found, expected = rgl.read_rgl(tmp_path / "brushed" / "brushed.bsdf")(angles), APP.reflectance(theta, angles)
    assert float((found - expected).abs().mean() / expected.mean()) < 0.05
    for suffix in ("", "_builtin"):
        scene = mi.load_file(str(tmp_path / "brushed" / f"brushed{suffix}.xml"))
        assert np.isfinite(np.array(mi.render(scene, spp=4))).all()
