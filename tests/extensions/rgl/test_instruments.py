"""Measurements into the files of other programs, by the command line: values are those that were measured."""

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from data_tools.readers.merl import evaluate_merl, merl_centres, read_merl, tabulate_merl, write_merl
from data_tools.readers.nbrdf_files import NBRDF_ARRAY_SHAPES, evaluate_nbrdf, write_nbrdf
from metapp.appearance.colorimetry import spectrum_to_rgb_matrix
from metapp.appearance.geometry import angle_cosines, directions_to_full_rusinkiewicz
from metapp.appearance.reflection import microfacet_lobe
from metapp.extensions.rgl import rgl
from metapp.extensions.rgl.spectra import WAVELENGTHS_NM, primary_spectra
from metapp.extensions.rgl.tensor_file import read_tensor_file, write_tensor_file
from tests.bsdfs import interactions_from, random_directions
from tests.needs_mitsuba import needs_mitsuba

pytestmark = [needs_mitsuba, pytest.mark.usefixtures("small_spheres")]
Pairs = tuple[np.ndarray, np.ndarray]  # lights and viewers, [3, N]
NANOMETRES = np.linspace(380, 730, 36)


def glossy(angles: Tensor) -> Tensor:
    """A GGX lobe of roughness 0.3 on an orange body: [..., 3] in 1/sr."""
    lobe = microfacet_lobe(
        angle_cosines(angles.double()), 0.3, lambda cos: 0.04 + 0.96 * (1 - cos) ** 5 * torch.ones(3)
    )
    return (lobe + torch.tensor([0.15, 0.06, 0.01])).to(angles)


@pytest.fixture
def pairs() -> Pairs:
    """Lights and viewers within 70 degrees of the normal, [3, N]."""
    light, viewer = random_directions(6000, 1), random_directions(6000, 2)
    near = np.minimum(light[2], viewer[2]) > math.cos(math.radians(70))
    return light[:, near][:, :1500], viewer[:, near][:, :1500]


def angles_of(pairs: Pairs) -> Tensor:
    light, viewer = (torch.from_numpy(vectors.T).double() for vectors in pairs)
    return directions_to_full_rusinkiewicz(light, viewer).float()


def difference(found: np.ndarray | Tensor, expected: np.ndarray | Tensor) -> float:
    """The median relative difference."""
    found, expected = np.asarray(found), np.asarray(expected)
    return float(np.median(abs(found - expected) / expected))


def evaluated(mi: Any, material: dict[str, str], pairs: Pairs) -> np.ndarray:
    """What a BSDF evaluates in an RGB variant, without the cosine, [N, 3]."""
    bsdf, (light, viewer) = mi.load_dict(material), pairs
    if mi.variant() == "scalar_rgb":
        values = np.empty_like(light)
        for i in range(light.shape[1]):
            interaction = mi.SurfaceInteraction3f()
            interaction.wi = viewer[:, i]
            values[:, i] = bsdf.eval(mi.BSDFContext(), interaction, light[:, i])
    else:
        values = np.array(
            bsdf.eval(mi.BSDFContext(), interactions_from(mi, viewer, viewer.shape[1]), mi.Vector3f(light))
        )
    return (values / light[2]).T


def integrate_spectrum(mi: Any, file: str | Path, pairs: Pairs) -> np.ndarray:
    """What `measured` evaluates at NANOMETRES in the variant llvm_ad_spectral, as linear RGB in D65, [N, 3]."""
    import drjit as dr

    mi.set_variant("llvm_ad_spectral")
    bsdf, (light, viewer), spectra = mi.load_dict(measured(file)), pairs, []
    for four in NANOMETRES.reshape(-1, 4):  # as many as Mitsuba evaluates at a time
        interaction = interactions_from(mi, viewer, viewer.shape[1])
        interaction.wavelengths = mi.Spectrum(*map(float, four))
        dr.make_opaque(interaction.wavelengths)  # one kernel for all
        spectra.append(np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(light))) / light[2])
    return np.concatenate(spectra).T @ spectrum_to_rgb_matrix(NANOMETRES)


def measured(file: str | Path) -> dict[str, str]:
    return {"type": "measured", "filename": str(file)}


@pytest.mark.parametrize("spectral", [False, True])
def test_an_rgl_file_becomes_a_merl_table(metapp: Callable, pairs: Pairs, spectral: bool) -> None:
    name = "paint_spec.bsdf" if spectral else "paint_rgb.bsdf"
    rgl.write_rgl(name, glossy, "paint", spectral=spectral)
    assert metapp("export", name, "merl", "--json").json_result == {"form": "merl", "out": "merl", "tasks": ["paint"]}
    table, angles = read_merl("merl/paint.binary"), angles_of(pairs)
    assert difference(evaluate_merl(table, angles), rgl.read_rgl(Path(name))(angles)) < 0.005
    assert difference(evaluate_merl(table, angles), glossy(angles)) < 0.005
    # as the reader published with the database has it: header, planes of red, green and blue, scaled
    assert np.fromfile("merl/paint.binary", "<i4", 3).tolist() == [90, 90, 180]
    bins = (10, 20, 90)
    stored = np.fromfile("merl/paint.binary", "<f8", offset=12).reshape(3, 90, 90, 180)[:, *bins]
    expected = glossy(merl_centres()[bins]).numpy() * 1500 / np.array([1, 1.15, 1.66])
    np.testing.assert_allclose(stored, expected, rtol=0.01)


def goniometer(file: Path) -> Path:
    """A table of 3,000 pairs of directions."""
    pairs = random_directions(3000, 4), random_directions(3000, 5)
    places = [part for x, y, z in pairs for part in (np.arctan2(np.hypot(x, y), z), np.arctan2(y, x))]
    rows = np.column_stack([*map(np.degrees, places), glossy(angles_of(pairs)).numpy()])
    names = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"
    np.savetxt(file, rows, fmt="%.8g", delimiter=",", header=names, comments="")
    return file


def test_samples_of_a_goniometer_load_as_measured_in_spectral_and_in_rgb_variants(
    metapp: Callable, mi: Any, pairs: Pairs
) -> None:
    """Either file shows the fit, which is close to the samples; Mitsuba refuses the other one: hence two."""
    table, forms = goniometer(Path("paint.csv")), "bsdf,bsdf-spectral"
    run = Path(metapp("meta", "brdf", table, "--export", forms, "--json", "-q").json_result["out"], "paint")
    rgb, spectral = measured(run / "bsdf" / "paint.bsdf"), measured(run / "bsdf-spectral" / "paint_spec.bsdf")
    fit = evaluated(mi, {"type": "neural_brdf", "filename": str(run / "params.safetensors")}, pairs)
    assert difference(fit, glossy(angles_of(pairs))) < 0.05
    assert difference(evaluated(mi, rgb, pairs), fit) < 0.005
    with pytest.raises(RuntimeError, match="require the use of a spectral variant"):
        mi.load_dict(spectral)
    assert difference(integrate_spectrum(mi, spectral["filename"], pairs), fit) < 0.005
    with pytest.raises(RuntimeError, match="require the use of a RGB variant"):
        mi.load_dict(rgb)
    mi.set_variant("scalar_spectral")
    mi.load_dict(spectral)
    mi.set_variant("scalar_rgb")
    few = (pairs[0][:, :50], pairs[1][:, :50])
    assert difference(evaluated(mi, rgb, few), fit[:50]) < 0.01


def test_a_spectral_rgl_file_is_converted_for_rgb_variants(metapp: Callable, mi: Any, pairs: Pairs) -> None:
    """Narrow spectra, as measured: what is seen in RGB is their colour."""
    rgl.write_rgl("paint.bsdf", glossy, "paint")
    fields = read_tensor_file("paint.bsdf")
    red, nanometres = fields.pop("rgb")[:, :, :1], np.arange(380, 781, 10, dtype=np.float32)
    band = (0.2 + np.exp(-(((nanometres - 560) / 40) ** 2))).astype(np.float32)
    write_tensor_file("felt_spec.bsdf", fields | {"wavelengths": nanometres, "spectra": red * band[:, None, None]})
    assert metapp("export", "felt_spec.bsdf", "bsdf", "--out", "rgb").code == 0
    found = evaluated(mi, measured("rgb/felt.bsdf"), pairs)
    assert found[:, 1].mean() > 1.2 * found[:, 0].mean() > 1.2 * found[:, 2].mean()
    assert difference(integrate_spectrum(mi, "felt_spec.bsdf", pairs), found) < 0.02
    # and back: another spectrum of the same colour
    assert metapp("export", "rgb/felt.bsdf", "bsdf-spectral", "--out", "back").code == 0
    assert difference(integrate_spectrum(mi, "back/felt_spec.bsdf", pairs), found) < 0.005


@pytest.mark.parametrize("kind", ["bsdf", "bsdf-spectral"])
def test_a_merl_table_becomes_an_rgl_file(metapp: Callable, mi: Any, pairs: Pairs, kind: str) -> None:
    write_merl("paint.binary", tabulate_merl(glossy))
    (name,) = metapp("export", "paint.binary", kind, "--out", "rgl", "--json").json_result["tasks"]
    show = (
        integrate_spectrum if kind == "bsdf-spectral" else lambda *what: evaluated(what[0], measured(what[1]), what[2])
    )
    found = show(mi, f"rgl/{name}.bsdf", pairs)
    assert difference(found, evaluate_merl(read_merl("paint.binary"), angles_of(pairs))) < 0.005
    assert difference(found, glossy(angles_of(pairs))) < 0.005


def test_networks_are_converted_and_not_with_other_files_of_the_folder_twice(metapp: Callable) -> None:
    random = np.random.default_rng(0)
    weights = {part: 0.1 * random.standard_normal(shape) for part, shape in NBRDF_ARRAY_SHAPES.items()}
    write_nbrdf("all/gold", weights)
    rgl.write_rgl("all/paint_rgb.bsdf", glossy, "paint")
    assert sorted(metapp("export", "all", "merl", "--json").json_result["tasks"]) == ["gold", "paint"]
    angles = angles_of((random_directions(500, 1), random_directions(500, 2)))
    angles[:, 2] %= math.pi
    both = torch.stack(
        [evaluate_nbrdf(weights, angles), evaluate_nbrdf(weights, angles + torch.tensor([0, 0, math.pi]))]
    )
    found = evaluate_merl(read_merl("merl/gold.binary"), angles)
    assert float((found - both.mean(0)).abs().mean()) < 0.01 * float(both.mean())


def test_files_that_cannot_be_converted_are_refused_in_one_line(metapp: Callable) -> None:
    goniometer(Path("paint.csv"))
    rgl.write_rgl("paint_rgb.bsdf", glossy, "paint")
    rgl.write_rgl("turned.bsdf", lambda angles: glossy(angles[:, :3]), "turned", azimuths=True)
    Path("cut.bsdf").write_bytes(Path("paint_rgb.bsdf").read_bytes()[:5000])

    def convert(*words: str, to: str = "merl") -> Any:
        return metapp("export", words[0], to, *words[1:], "--out", "out", "-q")

    assert convert("nowhere").refusal.startswith("error: nowhere: no such file, expected a run, MERL tables, RGL files")
    assert "paint.csv: not a run, expected no INPUT" in convert("paint.csv", "paint.csv").misuse
    assert convert("paint.csv").refusal.endswith("fit other measurements: metapp meta brdf paint.csv --export merl.")
    assert "turned.bsdf: anisotropic, expected an isotropic measurement" in convert("turned.bsdf").refusal
    assert "cut.bsdf: " in convert("cut.bsdf", to="bsdf").refusal
    assert not list(Path("out").glob("*"))
    for name in ("paint_rgb.bsdf", "paint_spec.bsdf"):
        Path("both").mkdir(exist_ok=True)
        shutil.copy("paint_rgb.bsdf", f"both/{name}")
    assert "both both/paint_rgb.bsdf and both/paint_spec.bsdf would be written to it" in convert("both").refusal
    assert convert("paint_rgb.bsdf", to="bsdf").code == 0
    assert "out/paint.bsdf: is there already" in convert("paint_rgb.bsdf", to="bsdf").misuse
    assert "out/paint.bsdf: is there already" in convert("out/paint.bsdf", to="bsdf").misuse


def test_spectra_of_primaries_are_reflectances_of_exactly_these_colours() -> None:
    spectra = primary_spectra()
    assert spectra.min() >= 0
    np.testing.assert_allclose(spectra.sum(0), 1, atol=1e-9)
    np.testing.assert_allclose(spectra @ spectrum_to_rgb_matrix(WAVELENGTHS_NM), np.eye(3), atol=1e-9)
    assert abs(np.diff(spectra)).max() < 0.85
