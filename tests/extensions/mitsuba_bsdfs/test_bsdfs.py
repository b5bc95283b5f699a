"""Mitsuba plugins of fits: Mitsuba's own tests of a BSDF, and agreement with metapp's evaluation."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors.torch import save_file
from torch import Tensor

from metapp.appearance.flash import evaluate_brdf
from metapp.appearance.geometry import (
    directions_to_four_angles,
    directions_to_full_rusinkiewicz,
    rusinkiewicz_to_directions,
)
from metapp.appearance.lobes import CANDIDATE_ALPHAS, VIEWER_NODES, LobeMixture
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import find_network
from metapp.learning.task import Task
from metapp.storage.files import read_tensors
from tests import anisotropic
from tests.bsdfs import assert_samples_follow_density, interactions_from, mirrored_pairs, random_directions
from tests.marked import long
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import asset_of

pytestmark = needs_mitsuba

NETWORKS = ("nbrdf", "featured")
BOTH = ["nbrdf", long("featured")]  # whose kernels take seconds to compile
ANGLES = (0, 30, 69, 80, 88)  # degrees
MATERIALS = {  # of maps: diffuse, specular, roughness
    "plaster": ((0.7, 0.6, 0.5), (0.04, 0.04, 0.04), 0.8),
    "gold": ((0.02, 0.01, 0.0), (1.0, 0.77, 0.34), 0.3),
    "odd": ((0.1, 0.4, 0.6), (0.6, 0.05, 0.3), 0.35),
    "glossy": ((0.1, 0.4, 0.6), (0.6, 0.05, 0.3), 0.12),
}
Neural = Callable[..., Any]


@pytest.fixture
def bsdf(mi: Any, load_neural_bsdf: Neural, request: pytest.FixtureRequest) -> Any:
    """A network or maps, by name."""
    return load_neural_bsdf(request.param) if request.param in NETWORKS else of_maps(mi, request.param)


def of_maps(mi: Any, name: str) -> Any:
    diffuse, specular, roughness = MATERIALS[name]
    colours = {
        key: {"type": "rgb", "value": list(value)} for key, value in (("diffuse", diffuse), ("specular", specular))
    }
    return mi.load_dict({"type": "neural_svbrdf", **colours, "roughness": roughness})


def tilted(degrees: float) -> list[float]:
    """A direction so far from the normal."""
    angle = math.radians(degrees)
    return [0.6 * math.sin(angle), 0.8 * math.sin(angle), math.cos(angle)]


def angles_of(light: NDArray[np.float32], viewer: NDArray[np.float32]) -> Tensor:
    """Half and difference angles [N, 3] over the full circle of phi_d: which of the two is the light counts."""
    return directions_to_full_rusinkiewicz(*(torch.from_numpy(vectors.T).double() for vectors in (light, viewer)))


def reflectance(file: Path, angles: Tensor) -> NDArray[np.float64]:
    """Ours, in double precision, [3, N]."""
    theta = {key: value.double() for key, value in read_tensors(file).items()}
    return find_network(theta).evaluate(theta, angles).numpy().T


@pytest.mark.parametrize("network", BOTH)
def test_plugin_evaluates_as_metapp_does(
    mi: Any, load_neural_bsdf: Neural, fits: dict[str, Path], network: str
) -> None:
    light, viewer = mirrored_pairs(20_000)
    bsdf, interaction = load_neural_bsdf(network), interactions_from(mi, viewer, light.shape[1])
    for mode, pair in ((mi.TransportMode.Radiance, (light, viewer)), (mi.TransportMode.Importance, (viewer, light))):
        expected = reflectance(fits[network], angles_of(*pair)) * light[2]
        found = np.array(bsdf.eval(mi.BSDFContext(mode), interaction, mi.Vector3f(light)))
        error = np.max(np.abs(found - expected) / (1 + np.abs(expected)), axis=0)
        # in the last degree before the horizon directions of single precision say no more about their angles
        assert error[np.minimum(light[2], viewer[2]) > 0.02].max() < 1e-5
        assert error.max() < 2e-4
    assert expected.max() > 1


@pytest.mark.long
def test_changed_weights_are_evaluated_from_memory_as_from_file(mi: Any, load_neural_bsdf: Neural) -> None:
    light, viewer = random_directions(1000, 1), random_directions(1000, 2)
    interaction, context = interactions_from(mi, viewer, 1000), mi.BSDFContext()
    for network in NETWORKS:
        bsdf = load_neural_bsdf(network)
        constant = np.array(bsdf.eval(context, interaction, mi.Vector3f(light)))
        bsdf.parameters_changed([])
        np.testing.assert_allclose(np.array(bsdf.eval(context, interaction, mi.Vector3f(light))), constant, 1e-4, 1e-6)
    small, numbers = load_neural_bsdf("nbrdf").reflection.network, np.random.default_rng(0).random((6, 50))
    inputs = [mi.Float(row) for row in numbers]
    np.testing.assert_allclose(
        np.array(small._apply_cooperative_vectors(inputs)), np.array(small._apply_gathered(inputs)), 1e-4, 1e-5
    )


@pytest.mark.parametrize(("bsdf", "other"), [("nbrdf", "Diffuse"), ("odd", "Null")], indirect=["bsdf"])
def test_reflectance_is_zero_below_the_surface(mi: Any, bsdf: Any, other: str) -> None:
    context, up, down = mi.BSDFContext(), tilted(30), [0.6, 0, -0.8]
    for viewer, light in ((up, down), (down, up), (down, down)):
        value, density = bsdf.eval_pdf(context, interactions_from(mi, viewer, 1), mi.Vector3f(light))
        assert np.array(value).max() == 0
        assert density[0] == 0
    context.type_mask = int(getattr(mi.BSDFFlags, other))
    assert bsdf.pdf(context, interactions_from(mi, up, 1), mi.Vector3f(up))[0] == 0


@pytest.mark.parametrize("bsdf", [*BOTH, "plaster", "gold", "odd"], indirect=True)  # no lobe below the grid's cells
@pytest.mark.parametrize("degrees", ANGLES)
def test_sampled_directions_follow_the_stated_density(
    mi: Any, bsdf: Any, degrees: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_samples_follow_density(mi, bsdf, tilted(degrees), samples=500_000, rings=32)


@pytest.mark.parametrize("bsdf", [*BOTH, *MATERIALS], indirect=True)
@pytest.mark.parametrize("degrees", ANGLES)
def test_sample_weights_are_values_over_densities(
    mi: Any, bsdf: Any, degrees: float, request: pytest.FixtureRequest
) -> None:
    """Value over density; little noise; and their mean, the albedo, is at most 1, of maps from above."""
    count = 40_000
    numbers = np.random.default_rng(5).random((3, count)).astype(np.float32)
    context, interaction = mi.BSDFContext(), interactions_from(mi, tilted(degrees), count)
    drawn, weight = bsdf.sample(context, interaction, mi.Float(numbers[0]), mi.Point2f(numbers[1:]))
    value, density = bsdf.eval_pdf(context, interaction, drawn.wo)
    value, density, weight = np.array(value), np.array(density), np.array(weight)
    np.testing.assert_allclose(density, np.array(bsdf.pdf(context, interaction, drawn.wo)), 1e-6)
    np.testing.assert_allclose(density, np.array(drawn.pdf), 1e-6)
    np.testing.assert_allclose(weight * density, value, 1e-5, 1e-8)
    assert weight.std() < 1.5 * weight.mean()
    name = request.node.callspec.params["bsdf"]
    if name in NETWORKS:
        assert 0.01 < weight.mean() <= 1
    elif degrees == 0:
        diffuse, specular, _ = (np.array(part) for part in MATERIALS[name])
        assert (weight.mean(1) < 1.005).all()
        assert (weight.mean(1) > 0.8 * (diffuse * (1 - specular) + specular)).all()


def test_plugin_works_inside_other_bsdfs_and_takes_a_tint(mi: Any, load_neural_bsdf: Neural) -> None:
    half = {"type": "rgb", "value": [0.5, 0.25, 1.0]}
    plain, tinted = load_neural_bsdf("nbrdf"), load_neural_bsdf("nbrdf", tint=half)
    light, viewer = mi.Vector3f(random_directions(500, 1)), random_directions(500, 2)
    context, interaction = mi.BSDFContext(), interactions_from(mi, viewer, 500)
    expected = np.array(plain.eval(context, interaction, light))
    coloured = np.array(tinted.eval(context, interaction, light))
    np.testing.assert_allclose(coloured, expected * [[0.5], [0.25], [1]], 1e-5)
    both = mi.load_dict({"type": "twosided", "inner": plain})
    below = interactions_from(mi, -viewer, 500)
    np.testing.assert_allclose(np.array(both.eval(context, below, -light)), expected, 1e-5, 1e-7)


@pytest.mark.parametrize("network", BOTH)
def test_gradients_agree_with_autograd_in_double_precision(
    mi: Any, load_neural_bsdf: Neural, fits: dict[str, Path], network: str
) -> None:
    """The expected gradients are those of the plain layers."""
    import drjit as dr

    light, viewer = random_directions(300, 1), random_directions(300, 2)
    values = reflectance(fits[network], angles_of(light, viewer)).min(0)
    smooth = (values > 1e-4) & (np.minimum(light[2], viewer[2]) > 0.05)  # away from the clamp at 0
    bsdf, light, viewer = load_neural_bsdf(network), light[:, smooth], viewer[:, smooth]
    assert len(light[0]) > 100
    parameters = mi.traverse(bsdf)
    keys = [f"{part}{layer}" for layer in range(3) for part in ("weights", "bias")]
    for key in keys:
        dr.enable_grad(parameters[key])
    value = bsdf.eval(mi.BSDFContext(), interactions_from(mi, viewer, len(light[0])), mi.Vector3f(light))
    dr.backward(dr.sum(value, axis=None))
    theta = read_tensors(fits[network])
    layers = [part for pair in find_network(theta).fold(theta).layers for part in pair]
    for part in layers:
        part.requires_grad_()
    total(layers, network, light, viewer).backward()  # type: ignore[no-untyped-call]
    for key, part in zip(keys, layers, strict=True):
        found = dr.grad(parameters[key]).numpy()
        assert part.grad is not None
        np.testing.assert_allclose(found, part.grad.numpy(), rtol=1e-3, atol=1e-4 * float(part.grad.abs().max()))


def total(layers: list[Tensor], network: str, light: NDArray[np.float32], viewer: NDArray[np.float32]) -> Tensor:
    """The sum of f cos theta over directions and channels, by plain layers."""
    from metapp.appearance.geometry import half_difference_and_cosine
    from metapp.apps.brdf.feature_network import isotropic_inputs

    where = half_difference_and_cosine(angles_of(light, viewer)).T[None]
    x = (isotropic_inputs(where) if network == "featured" else where[:, :6])[0]
    for layer in range(3):
        x = layers[2 * layer] @ x + layers[2 * layer + 1][:, None]
        if layer < 2:
            x = torch.nn.functional.silu(x) if network == "featured" else x.relu()
    return (torch.expm1(x).clamp_min(0) * torch.from_numpy(light[2])).sum()


def test_scene_xml_finds_fits_beside_it(mi: Any, fits: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "gold.safetensors").write_bytes(fits["nbrdf"].read_bytes())
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="sphere"><bsdf type="neural_brdf">'
        '<string name="filename" value="gold.safetensors"/></bsdf></shape></scene>'
    )
    bsdf = mi.load_file(str(tmp_path / "scene.xml")).shapes()[0].bsdf()
    assert str(bsdf).startswith(f'NeuralBrdf[filename = "{tmp_path / "gold.safetensors"}", layers = 6-21-21-3')


def test_a_folder_of_arrays_is_the_same_network(
    mi: Any, load_neural_bsdf: Neural, fits: dict[str, Path], tmp_path: Path
) -> None:
    from data_tools.readers import nbrdf_files

    nbrdf_files.export(asset_of(Brdf(), read_tensors(fits["nbrdf"]), Task("gold", {})), tmp_path / "gold", {})
    folder = mi.load_dict({"type": "neural_brdf", "filename": str(tmp_path / "gold")})
    arguments = (
        mi.BSDFContext(),
        interactions_from(mi, random_directions(100, 1), 100),
        mi.Vector3f(random_directions(100, 2)),
    )
    np.testing.assert_array_equal(
        np.array(folder.eval(*arguments)), np.array(load_neural_bsdf("nbrdf").eval(*arguments))
    )


def test_files_that_are_no_fit_are_refused_in_one_line(mi: Any, fits: dict[str, Path], tmp_path: Path) -> None:
    whole = read_tensors(fits["nbrdf"])
    save_file({"map": torch.zeros(3)}, tmp_path / "other.safetensors")
    save_file(whole | {"w1": torch.full_like(whole["w1"], math.nan)}, tmp_path / "nan.safetensors")
    (tmp_path / "text.safetensors").write_text("hello")
    for name, words in (
        ("other.safetensors", "tensors map, expected those of a BRDF fit"),
        ("nan.safetensors", "NaN or infinite values"),
        ("text.safetensors", "expected the .safetensors file of a BRDF fit"),
        ("nowhere", "no such"),
    ):
        with pytest.raises(RuntimeError, match="failed to instantiate") as caught:
            mi.load_dict({"type": "neural_brdf", "filename": str(tmp_path / name)})
        last = str(caught.value).splitlines()[-1]
        assert last.startswith("ValueError: ")
        assert words in last


def test_other_variants_are_refused_in_one_line(mi: Any, fits: dict[str, Path]) -> None:
    for variant in ("scalar_rgb", "llvm_ad_spectral"):
        mi.set_variant(variant)
        with pytest.raises(RuntimeError, match=rf"variant {variant}, expected llvm_ad_rgb or cuda_ad_rgb"):
            mi.load_dict({"type": "neural_brdf", "filename": str(fits["nbrdf"])})


def said(lines: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """What Python says of a program that may import mitsuba."""
    program = f"from metapp.rendering.variant import choose_llvm\nchoose_llvm()\nimport mitsuba as mi\n{lines}"
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, env=os.environ | environment
    )


@pytest.mark.long
@pytest.mark.parametrize("order", ["import metapp.mitsuba", "mi.set_variant('llvm_ad_rgb')"])
def test_plugins_may_be_imported_before_or_after_the_variant_is_set(fits: dict[str, Path], order: str) -> None:
    first, second = order, "mi.set_variant('llvm_ad_rgb')" if "import" in order else "import metapp.mitsuba"
    use = f"print(mi.load_dict({{'type': 'neural_brdf', 'filename': {str(fits['nbrdf'])!r}}}))"
    done = said("\n".join((first, second, "mi.set_variant('scalar_rgb')", "mi.set_variant('llvm_ad_rgb')", use)))
    assert done.stdout.startswith("NeuralBrdf["), done.stderr


def test_other_plugins_are_registered_without_the_extension() -> None:
    lines = ("import metapp.mitsuba", "mi.set_variant('llvm_ad_rgb')",
             "print(mi.load_dict({'type': 'metapp_guided_path'}).class_name())",
             "mi.load_dict({'type': 'neural_svbrdf'})")  # fmt: skip
    done = said("\n".join(lines), METAPP_WITHOUT="mitsuba_bsdfs")
    assert done.stdout, done.stderr
    assert "neural_svbrdf" in done.stderr
    assert done.returncode == 1


# Maps


@pytest.mark.parametrize("bsdf", MATERIALS, indirect=True)
def test_maps_reflect_as_the_fit_does(mi: Any, bsdf: Any, request: pytest.FixtureRequest) -> None:
    light, viewer = random_directions(2048, 1), random_directions(2048, 2)
    parts = (*MATERIALS[request.node.callspec.params["bsdf"]], (0, 0, 1))
    maps = Maps(*(torch.tensor(part).double().reshape(-1, 1, 1) for part in parts))
    expected = evaluate_brdf(maps, *(torch.from_numpy(vectors).double()[:, None] for vectors in (light, viewer)))[:, 0]
    found = np.array(bsdf.eval(mi.BSDFContext(), interactions_from(mi, viewer, 2048), mi.Vector3f(light)))
    expected = expected * torch.from_numpy(light[2])
    # single precision: at the peak of a narrow lobe the half vector's rounding counts
    torch.testing.assert_close(torch.from_numpy(found), expected.float(), rtol=5e-4, atol=1e-5)


def test_components_sum_to_the_whole_bsdf(mi: Any) -> None:
    bsdf, interaction, light = (
        of_maps(mi, "odd"),
        interactions_from(mi, random_directions(256, 1), 256),
        mi.Vector3f(random_directions(256, 2)),
    )
    parts = []
    for component in (0, 1):
        context = mi.BSDFContext()
        context.component = component
        parts.append(np.array(bsdf.eval(context, interaction, light)))
    assert np.allclose(sum(parts), np.array(bsdf.eval(mi.BSDFContext(), interaction, light)), rtol=1e-5)


def test_maps_have_gradients(mi: Any) -> None:
    import drjit as dr

    bsdf, interaction, light = (
        of_maps(mi, "odd"),
        interactions_from(mi, random_directions(32, 1), 32),
        mi.Vector3f(random_directions(32, 2)),
    )
    params, key = mi.traverse(bsdf), "roughness.value"

    def total(roughness: float | None = None) -> Any:
        if roughness is not None:
            params[key] = mi.Float(roughness)
        params.update()
        return dr.sum(dr.mean(bsdf.eval(mi.BSDFContext(), interaction, light)))

    dr.enable_grad(params[key])
    dr.backward(total())
    slope = float(dr.grad(params[key])[0])
    low, high = (float(total(0.35 + step)[0]) for step in (-1e-3, 1e-3))
    assert slope == pytest.approx((high - low) / 2e-3, rel=2e-2)


# Anisotropic fits


@pytest.fixture
def brushed(mi: Any, tmp_path: Path) -> Any:
    save_file(anisotropic.solve_for_brushed(), tmp_path / "fit.safetensors")
    return mi.load_dict({"type": "neural_brdf", "filename": str(tmp_path / "fit.safetensors")})


@pytest.mark.long
def test_an_anisotropic_fit_is_evaluated(mi: Any, brushed: Any) -> None:
    wi, wo = (anisotropic.random_directions(5000, seed, 0.2) for seed in (3, 4))
    interaction = interactions_from(mi, wo.T.float().numpy(), len(wi))
    found = np.array(brushed.eval(mi.BSDFContext(), interaction, mi.Vector3f(wi.T.float().numpy())))
    theta = {key: value.double() for key, value in anisotropic.solve_for_brushed().items()}
    expected = (anisotropic.APP.reflectance(theta, directions_to_four_angles(wi, wo)) * wi[:, 2:]).numpy().T
    assert (abs(found - expected) / (1 + abs(expected))).max() < 1e-4
    assert np.abs(expected).max() > 0.5
    other, _ = rusinkiewicz_to_directions(directions_to_four_angles(wo, wi))
    np.testing.assert_allclose(other.numpy(), wo.numpy(), atol=1e-6)
    brushed.parameters_changed([])  # from memory
    again = np.array(brushed.eval(mi.BSDFContext(), interaction, mi.Vector3f(wi.T.float().numpy())))
    np.testing.assert_allclose(again, found, 1e-3, 1e-5)


@pytest.mark.long
@pytest.mark.parametrize("degrees", anisotropic.VIEWERS_DEGREES[1:])
def test_anisotropic_samples_follow_the_stated_density(
    mi: Any, brushed: Any, degrees: tuple[float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sample weights have less noise than those of a diffuse lobe."""
    monkeypatch.chdir(tmp_path)
    viewer = anisotropic.direction_at_degrees(degrees)
    assert_samples_follow_density(mi, brushed, viewer, samples=300_000, rings=16)
    numbers = np.random.default_rng(5).random((3, 40_000)).astype(np.float32)
    interaction = interactions_from(mi, viewer, 40_000)
    _, weight = brushed.sample(mi.BSDFContext(), interaction, mi.Float(numbers[0]), mi.Point2f(numbers[1:]))
    weight = np.array(weight)
    assert weight.std() < 1.5 * weight.mean()
    assert weight.mean() <= 1


# Sampling by lobes


SHARES = np.tile([0.1, 0.5, 0.4], (VIEWER_NODES, 1))
MIXTURES = {
    "narrow": LobeMixture(
        ((CANDIDATE_ALPHAS[0], CANDIDATE_ALPHAS[0]), (CANDIDATE_ALPHAS[3], CANDIDATE_ALPHAS[3])), SHARES
    ),
    "wide": LobeMixture(
        ((CANDIDATE_ALPHAS[-1], CANDIDATE_ALPHAS[-1]), (CANDIDATE_ALPHAS[6], CANDIDATE_ALPHAS[6])), SHARES
    ),
    "anisotropic": LobeMixture(
        ((CANDIDATE_ALPHAS[-2], CANDIDATE_ALPHAS[2]), (CANDIDATE_ALPHAS[4], CANDIDATE_ALPHAS[8])), SHARES, 0.4
    ),
}
FINE, COARSE = 1920, 24  # rings of the quadrature and of the histogram; a ring has as many cells
AZIMUTH = 0.9  # of viewers, in rad
# azimuths are AZIMUTH + pi s^3, s from -1 to 1: dense where lobes are narrow at grazing angles


def hemisphere(mi: Any, mixture: Any, viewer: Any) -> NDArray[np.float64]:
    """The density's integral over each cell [COARSE, COARSE] of polar angle and s, by the midpoint rule."""
    import drjit as dr

    index = dr.arange(mi.UInt32, FINE * FINE)
    theta = (mi.Float(index // FINE) + 0.5) * (math.pi / 2 / FINE)
    s = (mi.Float(index % FINE) + 0.5) * (2 / FINE) - 1
    (sine, cosine), (sin_phi, cos_phi) = dr.sincos(theta), dr.sincos(AZIMUTH + math.pi * s * s * s)
    light = mi.Vector3f(-sine * cos_phi, -sine * sin_phi, cosine)
    values = np.array(mixture.density(viewer, light) * sine * (3 * math.pi * s * s), dtype=np.float64)
    side = FINE // COARSE
    cells: NDArray[np.float64] = values.reshape(COARSE, side, COARSE, side).sum((1, 3))
    return cells * (math.pi / 2 / FINE) * (2 / FINE)


@pytest.mark.parametrize("name", MIXTURES)
@pytest.mark.parametrize("degrees", [0, 30, 69, 85])
def test_density_integrates_to_1_and_is_that_of_samples(mi: Any, name: str, degrees: float) -> None:
    from metapp.extensions.mitsuba_bsdfs.mixture import MitsubaLobeMixture

    mixture, angle, count = MitsubaLobeMixture(MIXTURES[name]), math.radians(degrees), 200_000
    sine = math.sin(angle)
    viewer = mi.Vector3f(sine * math.cos(AZIMUTH), sine * math.sin(AZIMUTH), math.cos(angle))
    expected = hemisphere(mi, mixture, viewer)
    assert expected.sum() == pytest.approx(1, abs=1e-3)
    numbers = np.random.default_rng(3).random((3, count)).astype(np.float32)
    light = np.array(mixture.sample(viewer, mi.Float(numbers[0]), mi.Point2f(numbers[1:])), dtype=np.float64)
    assert (light[2] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(light, axis=0), 1, atol=1e-5)
    theta = np.arctan2(np.hypot(light[0], light[1]), light[2])
    s = np.cbrt(((np.arctan2(-light[1], -light[0]) - AZIMUTH) / math.pi + 1) % 2 - 1)
    found, _, _ = np.histogram2d(theta, s, COARSE, [[0, math.pi / 2], [-1, 1]])
    assert found.sum() == count
    # of each cell the count is binomial: five standard deviations, and one sample for cells of few
    assert (abs(found - count * expected) <= 5 * np.sqrt(count * expected * (1 - expected)) + 1).all()
