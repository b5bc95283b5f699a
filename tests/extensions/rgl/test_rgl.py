"""RGL files: Mitsuba loads what is written and evaluates it as the fit; what is read is what Mitsuba evaluates."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp.appearance.colorimetry import import_colour_science
from metapp.appearance.geometry import angle_cosines, directions_to_full_rusinkiewicz
from metapp.appearance.reflection import microfacet_lobe
from metapp.extensions.rgl import rgl
from metapp.extensions.rgl.rgl import write_rgl
from metapp.extensions.rgl.tensor_file import read_tensor_file, write_tensor_file
from tests.bsdfs import interactions_from
from tests.found_paths import find_paths
from tests.needs_mitsuba import needs_mitsuba


def glossy(angles: Tensor) -> Tensor:
    """A GGX lobe of roughness 0.1 on a diffuse body, coloured: [..., 3] in 1/sr."""
    lobe = microfacet_lobe(
        angle_cosines(angles.double()), 0.1, lambda cos: 0.04 + 0.96 * (1 - cos) ** 5 * torch.ones(3)
    )
    return (lobe + torch.tensor([0.1, 0.05, 0.02])).to(angles)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rgl") / "glossy.bsdf"
    write_rgl(path, glossy, "glossy")
    return path


def draws(mi: Any, bsdf: Any, degrees: tuple[float, float], count: int = 50_000) -> tuple[Any, Any, Any, Any]:
    """Viewers within such angles, lights that a BSDF draws for them, and its weights."""
    numbers = np.random.default_rng(1).random((5, count)).astype(np.float32)
    theta, phi = np.radians(degrees[0] + (degrees[1] - degrees[0]) * numbers[0]), 2 * np.pi * numbers[1]
    viewer = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    interaction = interactions_from(mi, viewer, count)
    drawn, weight = bsdf.sample(mi.BSDFContext(), interaction, mi.Float(numbers[2]), mi.Point2f(numbers[3:]))
    return interaction, drawn.wo, np.array(drawn.pdf), np.array(weight)


@needs_mitsuba
@pytest.mark.parametrize("degrees", [(0, 30), (30, 60), (60, 80), (80, 89)])
def test_mitsuba_evaluates_the_table_as_what_was_tabulated(mi: Any, file: Path, degrees: tuple[float, float]) -> None:
    """The mean within 1 %, over directions that it draws itself; so do the weights of these."""
    bsdf = mi.load_dict({"type": "measured", "filename": str(file)})
    interaction, light, density, weight = draws(mi, bsdf, degrees)
    found = np.array(bsdf.eval(mi.BSDFContext(), interaction, light))
    pair = (torch.from_numpy(np.array(vectors).T).double() for vectors in (light, interaction.wi))
    up = (density > 0) & (np.array(light.z) > 0)
    expected = glossy(directions_to_full_rusinkiewicz(*pair)).numpy().T * np.array(light.z) * up
    density = np.where(up, density, 1)
    np.testing.assert_allclose((found * up / density).mean(1), (expected / density).mean(1), rtol=0.01)
    assert (np.abs(found * up - expected) / density).mean() < 0.02 * (expected / density).mean()
    np.testing.assert_allclose(weight.mean(1), (expected / density).mean(1), rtol=0.02)
    assert weight.std() < weight.mean() * 0.8


@needs_mitsuba
@pytest.mark.usefixtures("small_spheres")
def test_tables_read_back_as_written(file: Path, random_angles: Callable[..., Tensor]) -> None:
    angles = random_angles(2000)
    angles = angles[torch.minimum(angle_cosines(angles).incident, angle_cosines(angles).outgoing) > 0.1]
    found, expected = rgl.read_rgl(file)(angles), glossy(angles)
    assert found.shape == expected.shape
    assert float((found - expected).abs().mean() / expected.mean()) < 0.01
    task = rgl.read_task(file, samples=256)
    assert (task.name, task.data["reflectance"].shape) == ("glossy", (256, 3))
    assert find_paths(rgl.find, file.parent) == ([file], [])
    assert rgl.recognises(file.parent)


def test_tensor_files_come_back_unless_cut_or_empty(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "text": np.frombuffer(b"hello", np.uint8)}
    write_tensor_file(tmp_path / "x", arrays)
    found = read_tensor_file(tmp_path / "x")
    assert found.keys() == arrays.keys()
    for key, array in arrays.items():
        np.testing.assert_array_equal(found[key], array)
    content = (tmp_path / "x").read_bytes()
    for cut in range(len(content)):
        (tmp_path / "cut").write_bytes(content[:cut])
        with pytest.raises(ValueError, match=r"cut: .*expected"):
            read_tensor_file(tmp_path / "cut")
    write_tensor_file(tmp_path / "x", {"a": np.zeros((2, 0, 3), np.float32)})
    with pytest.raises(ValueError, match=r"x: .*expected a whole tensor file"):
        read_tensor_file(tmp_path / "x")


NANOMETRES = np.arange(380.0, 781, 5)


def spectral(file: Path, path: Path, reflectance: np.ndarray, nanometres: np.ndarray = NANOMETRES) -> Path:
    """Write a file as another one whose red is each wavelength's, times a reflectance [W]."""
    fields = read_tensor_file(file)
    red = fields.pop("rgb")[:, :, :1]
    spectra = (red * reflectance[:, None, None]).astype(np.float32)
    write_tensor_file(path, fields | {"wavelengths": nanometres.astype(np.float32), "spectra": spectra})
    return path


FEWER = np.linspace(450, 700, len(NANOMETRES), dtype="f4")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("rgb", lambda rgb: np.where(rgb > 0, np.nan, rgb).astype("f4"), "rgb has NaN"),
        ("rgb", lambda rgb: rgb[:, :, :, 1:], "rgb .*expected"),
        ("luminance", lambda values: -values, "luminance negative"),
        ("vndf", lambda values: values * 0, "vndf negative or 0"),
        ("theta_i", lambda values: values[::-1], "not ascending"),
        ("sigma", lambda values: values.astype("f8"), "sigma of type float64"),
        ("rgb", lambda values: -values, "rgb from -.* to .*, expected reflectance of 0 or more"),
        ("sigma", lambda values: -values, "sigma with values of 0 or less"),
        ("ndf", lambda values: -values, "ndf with values below 0"),
        ("theta_i", lambda values: values * 2, r"theta_i from 0 to 3\.\d+, expected 0 to 1\.571 rad"),
        ("phi_i", lambda values: values + np.float32(9), r"phi_i from 9 to 9, expected -3\.142 to 3\.142 rad"),
        ("phi_i", lambda values: np.linspace(0, 1, 8, dtype="f4"), "vndf .*expected"),
        ("rgb", None, "field rgb of no axes"),
        (
            "wavelengths",
            lambda _: FEWER,
            r"81 wavelengths from 450 to 700 nm, expected 4 or more that cover 420 to 680",
        ),
        ("wavelengths", lambda values: values[::-1], "wavelengths not ascending"),
        ("wavelengths", lambda values: values * np.float32(np.nan), "wavelengths has NaN"),
        ("wavelengths", lambda values: values[1:], r"spectra .*expected .*80"),
        ("wavelengths", None, "field wavelengths of no axes"),
    ],
)
def test_damaged_files_are_refused_in_one_line(
    file: Path, tmp_path: Path, name: str, change: Callable[[Any], Any] | None, words: str
) -> None:
    path = tmp_path / "bad.bsdf"
    if name == "wavelengths":
        file = spectral(file, path, np.ones(len(NANOMETRES)))
    fields = read_tensor_file(file)
    fields = {key: value for key, value in fields.items() if key != name or change}
    write_tensor_file(path, fields | ({name: change(fields[name])} if change else {}))
    with pytest.raises(ValueError, match=words) as caught:
        rgl.read_rgl(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_noise_below_zero_is_taken_as_0_with_a_warning(file: Path, tmp_path: Path) -> None:
    fields = read_tensor_file(file)
    noisy = fields["luminance"].copy()
    noisy[..., 0, 0] = -1e-7 * noisy.max()
    write_tensor_file(tmp_path / "noisy.bsdf", fields | {"luminance": noisy})
    angles = torch.tensor([[0.1, 0.4, 1.0], [0.6, 0.2, 2.0]])
    with pytest.warns(UserWarning, match=r"noisy\.bsdf: luminance as low as -.*taken for noise"):
        found = rgl.read_rgl(tmp_path / "noisy.bsdf")(angles)
    torch.testing.assert_close(found, rgl.read_rgl(file)(angles))


@pytest.mark.filterwarnings("ignore:Aligning")
def test_flat_spectra_are_gray_and_bands_have_the_colour_that_colour_science_gives_them(
    file: Path, tmp_path: Path
) -> None:
    """The band's colour is by ASTM E308, not by the integration at each nanometre that spectra are converted by."""
    angles = torch.tensor([[0.1, 0.4, 1.0], [0.6, 0.2, 2.0], [0.0, 1.0, 0.5]])
    red = rgl.read_rgl(file)(angles)[:, :1]
    flat = rgl.read_rgl(spectral(file, tmp_path / "flat_spec.bsdf", np.full(len(NANOMETRES), 0.4)))(angles)
    torch.testing.assert_close(flat, (0.4 * red).expand(-1, 3), rtol=1e-5, atol=0)
    band = np.exp(-(((NANOMETRES - 530) / 15) ** 2))
    colour = import_colour_science()
    spectrum = colour.SpectralDistribution(band, NANOMETRES)
    xyz = colour.sd_to_XYZ(spectrum, illuminant=colour.SDS_ILLUMINANTS["D65"]) / 100
    expected = torch.from_numpy(colour.XYZ_to_RGB(xyz, "sRGB")).float()
    assert expected.argmax() == 1
    assert expected.min() < -0.05  # outside of Rec.709: reflectance is not negative
    found = rgl.read_rgl(spectral(file, tmp_path / "band_spec.bsdf", band))(angles)
    torch.testing.assert_close(found, expected.clamp_min(0) * red, rtol=5e-3, atol=2e-4)
    assert rgl.read_task(tmp_path / "band_spec.bsdf", samples=64).name == "band_spec"


def test_stored_colours_are_preferred_to_spectra(file: Path, tmp_path: Path) -> None:
    spectra = read_tensor_file(spectral(file, tmp_path / "spec.bsdf", np.ones(len(NANOMETRES))))
    write_tensor_file(tmp_path / "both.bsdf", spectra | read_tensor_file(file))
    angles = torch.tensor([[0.1, 0.4, 1.0], [0.6, 0.2, 2.0]])
    torch.testing.assert_close(rgl.read_rgl(tmp_path / "both.bsdf")(angles), rgl.read_rgl(file)(angles))
