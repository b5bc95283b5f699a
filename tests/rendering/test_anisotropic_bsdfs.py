"""Anisotropic BRDFs in Mitsuba: the plugin, and files for `measured`, whose values and draws agree at any azimuth."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors.torch import save_file
from torch import Tensor

from data_tools.readers import rgl
from data_tools.readers.rgl import write_rgl, write_tensor_file
from metapp.appearance.geometry import cosines, directions_to_four_angles, rusinkiewicz_to_directions
from metapp.appearance.reflection import microfacet_lobe
from tests import anisotropic
from tests.anisotropic import APP, brushed, brushed_directions
from tests.needs_mitsuba import needs_mitsuba

pytestmark = [needs_mitsuba, pytest.mark.long]
VIEWERS = ((10, 0), (40, 70), (40, 200), (65, 310))  # degrees: theta, phi
RESOLUTION = 64  # of the tables of a file as the database has it


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files by what they are of: isotropic and anisotropic as they are written here, and as the database has them."""
    folder = tmp_path_factory.mktemp("files")
    paths = {name: folder / f"{name}.bsdf" for name in ("isotropic", "anisotropic", "database")}
    write_rgl(paths["isotropic"], glossy, "isotropic")
    write_rgl(paths["anisotropic"], brushed, "anisotropic", azimuths=True)
    write_as_the_database(paths["database"])
    save_file(anisotropic.fitted(), folder / "fit.safetensors")
    return paths | {"fit": folder / "fit.safetensors"}


def glossy(angles: Tensor) -> Tensor:
    """A GGX lobe on a diffuse body: [..., 3] in 1/sr."""
    lobe = microfacet_lobe(cosines(angles.double()), 0.15, lambda cos: 0.04 + 0.96 * (1 - cos) ** 5 * torch.ones(3))
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
    half = direction(u**2 * math.pi / 2, (2 * v - 1) * math.pi)
    viewers = direction(theta[None], phi[:, None])
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
        normal = direction(at[0] ** 2 * math.pi / 2, (2 * at[1] - 1) * math.pi)
        viewer = viewers[i, j]
        light = 2 * (normal @ viewer)[:, None] * normal - viewer
        up = light[:, 2] > 1e-3
        safe = np.where(up[:, None], light, [0, 0, 1.0])
        pair = (torch.from_numpy(np.broadcast_to(each, safe.shape).copy()) for each in (safe, viewer))
        value = brushed_directions(*pair)
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


def direction(theta: Any, phi: Any) -> NDArray[np.float64]:
    """Unit vectors [..., 3] of angles in rad."""
    parts = np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    return np.stack(parts, -1).astype(np.float64)


def loaded(mi: Any, file: Path) -> Any:
    kind = "measured" if file.suffix == ".bsdf" else "neural_brdf"
    return mi.load_dict({"type": kind, "filename": str(file)})


@pytest.fixture
def bsdf(mi: Any, files: dict[str, Path], request: pytest.FixtureRequest) -> Any:
    return loaded(mi, files[request.param])


def seen_from(mi: Any, degrees: tuple[float, float], count: int) -> Any:
    import drjit as dr

    interaction = dr.zeros(mi.SurfaceInteraction3f, count)
    interaction.wi = mi.Vector3f(*direction(*np.radians(degrees)).tolist())
    dr.make_opaque(interaction.wi)
    return interaction


@pytest.mark.parametrize(("name", "least"), [("anisotropic", 0.02), ("database", 0.05)])
def test_files_are_read_as_what_they_were_made_of(files: dict[str, Path], name: str, least: float) -> None:
    assert rgl.is_anisotropic(files[name])
    wi, wo = (directions(4000, seed) for seed in (1, 2))
    angles = directions_to_four_angles(wi, wo)
    found, expected = rgl.read_rgl(files[name])(angles), brushed(angles)
    assert float((found - expected).abs().mean() / expected.mean()) < least
    shares = [float((torch.log(found + 0.01) - torch.log(brushed(other) + 0.01)).abs().mean()) for other in (
        angles, directions_to_four_angles(*(each * torch.tensor([1.0, -1.0, 1.0]) for each in (wi, wo))))]  # fmt: skip
    assert shares[0] < 0.2 * shares[1]  # no mirror image


def test_they_are_refused_where_there_is_no_azimuth(files: dict[str, Path]) -> None:
    with pytest.raises(ValueError, match=r"anisotropic.bsdf: anisotropic, expected an isotropic measurement") as caught:
        rgl.read_rgl(files["anisotropic"])(torch.zeros(5, 3))
    assert "\n" not in str(caught.value)
    task = rgl.read_task(files["anisotropic"], samples=256)
    assert task.data["phi_h"].shape == (256,)


def directions(count: int, seed: int) -> Tensor:
    """Unit vectors, not along the surface, float64."""
    vectors = torch.randn(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    vectors[:, 2] = vectors[:, 2].abs() + 0.2
    return vectors / vectors.norm(dim=1, keepdim=True)


@pytest.mark.parametrize("bsdf", ["isotropic", "anisotropic", "database"], indirect=True)
@pytest.mark.parametrize("degrees", VIEWERS)
def test_drawn_directions_follow_the_values(mi: Any, bsdf: Any, degrees: tuple[float, float]) -> None:
    """In 12 x 6 cells of azimuth and height; none is flipped in azimuth (pull request 1850 of Mitsuba 3)."""
    count = 200_000
    numbers = np.random.default_rng(0).random((3, count)).astype(np.float32)
    drawn, weight = bsdf.sample(mi.BSDFContext(), seen_from(mi, degrees, count), mi.Float(numbers[0]),
                                mi.Point2f(numbers[1:]))  # fmt: skip
    light, weight = np.array(drawn.wo), np.array(weight).mean(0)
    up = (light[2] > 0) & (np.array(drawn.pdf) > 0)
    found = cells(light, np.where(up, weight, 0)) / count
    uniform = np.random.default_rng(1).random((2, 400_000)).astype(np.float32)
    radius, phi = np.sqrt(1 - uniform[0] ** 2), 2 * math.pi * uniform[1]
    every = np.stack([radius * np.cos(phi), radius * np.sin(phi), uniform[0]])
    values = np.array(bsdf.eval(mi.BSDFContext(), seen_from(mi, degrees, every.shape[1]), mi.Vector3f(every))).mean(0)
    expected = cells(every, values) * 2 * math.pi / every.shape[1]
    assert abs(found - expected).sum() < 0.05 * expected.sum()
    assert abs(found - expected[::-1]).sum() > 0.2 * expected.sum() or degrees[1] in (0, 180)


def cells(light: NDArray[np.float32], weights: NDArray[np.float32]) -> NDArray[np.float64]:
    """Sums of weights by azimuth and squared height."""
    azimuth = np.arctan2(light[1], light[0])
    result: NDArray[np.float64] = np.histogram2d(azimuth, light[2] ** 2, bins=(12, 6), weights=weights,
                                                 range=((-math.pi, math.pi), (0, 1)))[0]  # fmt: skip
    return result


def test_the_plugin_evaluates_the_fit(mi: Any, files: dict[str, Path]) -> None:
    wi, wo = (directions(5000, seed) for seed in (3, 4))
    import drjit as dr

    interaction = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    interaction.wi = mi.Vector3f(wo.T.float().numpy())
    bsdf = loaded(mi, files["fit"])
    found = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(wi.T.float().numpy())))
    theta = {key: value.double() for key, value in anisotropic.fitted().items()}
    expected = (APP.reflectance(theta, directions_to_four_angles(wi, wo)) * wi[:, 2:]).numpy().T
    assert (abs(found - expected) / (1 + abs(expected))).max() < 1e-4
    assert np.abs(expected).max() > 0.5
    other, _ = rusinkiewicz_to_directions(directions_to_four_angles(wo, wi))
    np.testing.assert_allclose(other.numpy(), wo.numpy(), atol=1e-6)
    bsdf.parameters_changed([])  # from memory
    again = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(wi.T.float().numpy())))
    np.testing.assert_allclose(again, found, 1e-3, 1e-5)


@pytest.mark.parametrize("degrees", VIEWERS[1:])
def test_the_plugin_samples_as_densely_as_it_says(
    mi: Any, files: dict[str, Path], degrees: tuple[float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mitsuba's own test; and with less noise than a diffuse lobe would have."""
    import drjit as dr

    monkeypatch.chdir(tmp_path)
    bsdf, context = loaded(mi, files["fit"]), mi.BSDFContext()

    def draw(numbers: Any) -> Any:
        drawn, _ = bsdf.sample(context, seen_from(mi, degrees, len(numbers[0])), numbers[0],
                               mi.Point2f(numbers[1], numbers[2]))  # fmt: skip
        is_drawn = drawn.pdf > 0
        return dr.select(is_drawn, drawn.wo, mi.Vector3f(0, 0, -1)), mi.Float(is_drawn)

    def density(light: Any) -> Any:
        return bsdf.pdf(context, seen_from(mi, degrees, len(light.x)), light)

    test = mi.chi2.ChiSquareTest(mi.chi2.SphericalDomain(), draw, density, sample_dim=3, sample_count=300_000, ires=16)
    assert test.run(), test.messages
    numbers = np.random.default_rng(5).random((3, 40_000)).astype(np.float32)
    _, weight = bsdf.sample(context, seen_from(mi, degrees, 40_000), mi.Float(numbers[0]), mi.Point2f(numbers[1:]))
    weight = np.array(weight)
    assert weight.std() < 1.5 * weight.mean()
    assert weight.mean() <= 1


def test_exports_of_a_fit_are_anisotropic(mi: Any, files: dict[str, Path], tmp_path: Path) -> None:
    from data_tools.assets import mitsuba as assets

    theta = anisotropic.fitted()
    assets.export(APP, theta, tmp_path / "brushed")
    assert rgl.is_anisotropic(tmp_path / "brushed" / "brushed.bsdf")
    angles = directions_to_four_angles(directions(3000, 1), directions(3000, 2)).float()
    found, expected = rgl.read_rgl(tmp_path / "brushed" / "brushed.bsdf")(angles), APP.reflectance(theta, angles)
    assert float((found - expected).abs().mean() / expected.mean()) < 0.05
    for suffix in ("", "_builtin"):
        scene = mi.load_file(str(tmp_path / "brushed" / f"brushed{suffix}.xml"))
        assert np.isfinite(np.array(mi.render(scene, spp=4))).all()
