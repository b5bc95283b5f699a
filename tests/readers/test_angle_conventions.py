"""Angles that are not what their columns say are asked about, with the columns' right names; honest tables are not."""

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import gonio
from data_tools.readers.gonio_angles import name_angle
from data_tools.synthetic.brdf_models import conductor, diffuse, oren_nayar, plastic, sheen
from metapp.appearance.geometry import direction_cosines
from tests.anisotropic import brushed_reflectance, direction_at_angles, random_directions
from tests.cli.messages import says

Doubles = NDArray[np.float64]
Material = Callable[[Tensor, Tensor], Tensor]
NAMES = ("theta_i", "phi_i", "theta_o", "phi_o")


def isotropic(model: Callable) -> Material:
    return lambda wi, wo: model(direction_cosines(wi, wo, wi.new_tensor([0.0, 0.0, 1.0])))


def retro_reflector(wi: Tensor, wo: Tensor) -> Tensor:
    return 0.1 + 3 * torch.exp(((wi * wo).sum(1, keepdim=True) - 1) / 0.01).expand(-1, 3)


METAL = ((0.2, 0.9, 1.1), (3.9, 2.4, 2.4))
GREY = (0.3, 0.3, 0.3)
GLOSSY = {
    "shiny metal": isotropic(conductor(*METAL, 0.05, "ggx")),
    "rough metal": isotropic(conductor(*METAL, 0.3, "beckmann")),
    "shiny plastic": isotropic(plastic(GREY, 0.05, "ggx")),
    "rough plastic": isotropic(plastic(GREY, 0.3, "ggx")),
    "dark plastic": isotropic(plastic((0.03, 0.03, 0.03), 0.15, "beckmann")),
}
MATERIALS = GLOSSY | {
    "velvet": isotropic(sheen(oren_nayar(GREY, 0.5), (0.6, 0.6, 0.6), 0.5)),
    "clay": isotropic(oren_nayar(GREY, 0.5)),
    "chalk": isotropic(diffuse(GREY)),
    "brushed metal": brushed_reflectance,
}


def mesh(theta_i: Doubles, phi_i: Doubles, theta_o: Doubles, phi: Doubles) -> Doubles:
    """Return theta_i, phi_i, theta_o and phi_o of a goniometer that stops at steps, in degrees, [N, 4]."""
    axes = [axis.ravel() for axis in np.meshgrid(theta_i, phi_i, theta_o, phi, indexing="ij")]
    return np.stack([*axes[:3], (axes[1] + axes[3]) % 360], 1)


def scattered(count: int) -> Doubles:
    columns = []
    for seed in (1, 2):
        x, y, z = random_directions(count, seed, 0.2).T.numpy()
        columns += [np.degrees(np.arccos(z)), np.degrees(np.arctan2(y, x))]
    return np.stack(columns, 1)


ZERO = np.zeros(1)
PLACES = {
    "half circle": mesh(np.arange(10, 81, 10.0), ZERO, np.arange(5, 86, 5.0), np.arange(0, 181, 15.0)),
    "few lights": mesh(np.array([20.0, 60.0]), ZERO, np.arange(5, 81, 5.0), np.arange(0, 360, 20.0)),
    "plane": mesh(np.arange(10, 81, 10.0), ZERO, np.arange(-85, 86, 5.0), ZERO),
    "turned sample": mesh(
        np.arange(10, 81, 20.0), np.arange(0, 360, 60.0), np.arange(5, 81, 15.0), np.arange(0, 360, 40.0)
    ),
    "scattered": scattered(1000),
}  # fmt: skip
SPACE = ("half circle", "few lights", "turned sample", "scattered")


def lines_about(path: Path, places: Doubles, columns: Doubles, head: str, material: Material, noise: float = 0) -> str:
    """Write what is measured of a material at places, under angles [N, 4] that may mean others; return all warnings."""
    angles = np.radians(places)
    wi, wo = (torch.from_numpy(direction_at_angles(angles[:, i], angles[:, i + 1])) for i in (0, 2))
    draws = torch.randn(len(places), 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    values = material(wi, wo).double() * torch.exp(noise * draws)
    rows = np.column_stack([columns, values.numpy()])
    np.savetxt(path, rows, delimiter=",", header=f"{head},r,g,b", comments="", fmt="%.7g")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gonio.read_pairs(path)
    return "\n".join(str(warning.message) for warning in caught)


def head_of(*names: str, unit: str = "deg") -> str:
    return ",".join(f"{name}_{unit}" for name in names)


def flip(theta: Doubles) -> Doubles:
    return np.copysign(90 - np.abs(theta), theta)


@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("material", [*MATERIALS])
@pytest.mark.parametrize("place", PLACES)
def test_angles_of_honest_tables_are_not_asked_about(tmp_path: Path, place: str, material: str, noise: float) -> None:
    places = PLACES[place]
    assert not lines_about(tmp_path / "a.csv", places, places, head_of(*NAMES), MATERIALS[material], noise)


@pytest.mark.parametrize("material", GLOSSY)
@pytest.mark.parametrize("place", SPACE)
def test_azimuths_from_the_mirror_direction_are_asked_about(tmp_path: Path, place: str, material: str) -> None:
    """From -180 to 180 degrees, or to 360."""
    places, columns = PLACES[place], PLACES[place].copy()
    columns[:, 3] = columns[:, 3] - 180 if material.startswith("shiny") else (columns[:, 3] + 180) % 360
    line = lines_about(tmp_path / "a.csv", places, columns, head_of(*NAMES), GLOSSY[material], 0.05)
    varies = np.ptp(places[:, 1]) > 0
    remedy = "add 180 degrees to phi_i_deg" if varies else "rename phi_o_deg to phi_mirror_deg"
    assert says(line, "a.csv: values peak back at the light", "explain", "?", remedy)


@pytest.mark.parametrize("material", ["shiny metal", "shiny plastic", "dark plastic"])
@pytest.mark.parametrize("head", ["theta_i_deg,theta_o_deg,phi_deg", "theta_in_deg,theta_out_deg,azimuth_deg"])
def test_three_angles_in_the_plane_are_asked_about(tmp_path: Path, head: str, material: str) -> None:
    places = PLACES["plane"]
    columns = np.abs(places[:, [0, 2, 2]])
    columns[:, 2] = np.where(places[:, 2] < 0, 0, 180)  # the mirror direction is at -theta_o
    line = lines_about(tmp_path / "a.csv", places, columns, head, GLOSSY[material])
    assert says(line, "values peak back at the light", f"rename {head.split(',')[2]} to phi_mirror_deg")


@pytest.mark.parametrize("place", [*PLACES])
def test_a_retro_reflector_is_asked_about_and_read_as_it_is(tmp_path: Path, place: str) -> None:
    places = PLACES[place]
    line = lines_about(tmp_path / "a.csv", places, places, head_of(*NAMES), retro_reflector)
    assert says(line, "as of a retro-reflector", "?")


@pytest.mark.parametrize("flipped", ["io", "i", "o"])
@pytest.mark.parametrize("material", ["shiny metal", "rough plastic", "velvet", "brushed metal"])
@pytest.mark.parametrize("place", SPACE)
def test_elevations_called_thetas_are_asked_about(tmp_path: Path, place: str, material: str, flipped: str) -> None:
    places = PLACES[place]
    columns = places.copy()
    for direction in flipped:
        column = NAMES.index(f"theta_{direction}")
        columns[:, column] = flip(columns[:, column])
    line = lines_about(tmp_path / "a.csv", places, columns, head_of(*NAMES), MATERIALS[material])
    remedies = [f"rename theta_{direction}_deg to elevation_{direction}_deg" for direction in flipped]
    assert says(line, "another reading", *remedies)


def test_the_renamed_columns_are_read_and_not_asked_about(tmp_path: Path) -> None:
    """And a table that is renamed without need is."""
    places, material = PLACES["half circle"], GLOSSY["rough plastic"]
    columns = np.stack([flip(places[:, 0]), places[:, 1], flip(places[:, 2]), places[:, 3] - 180], 1)
    head = head_of("elevation_i", "phi_i", "elevation_o", "phi_mirror")
    assert not lines_about(tmp_path / "a.csv", places, columns, head, material)
    assert not lines_about(tmp_path / "b.csv", places, places, head_of(*NAMES), material)
    found, expected = (gonio.read_pairs(tmp_path / f"{name}.csv") for name in ("a", "b"))
    for values, expected_values in zip(found, expected, strict=True):
        torch.testing.assert_close(values, expected_values, rtol=0, atol=1e-6)
    line = lines_about(tmp_path / "c.csv", places, places, head, material)
    assert says(line, "rename elevation_i_deg to theta_i_deg", "rename elevation_o_deg to theta_o_deg")
    head = head_of("theta_i", "phi_i", "theta_o", "phi_mirror")
    line = lines_about(tmp_path / "d.csv", places, places, head, material)
    assert says(line, "values peak back at the light", "rename phi_mirror_deg to phi_deg")


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("with_light", [True, False])
def test_all_azimuths_of_the_detector_are_read(tmp_path: Path, unit: str, with_light: bool) -> None:
    """Absolute, from the light, and from the mirror direction; elevations beyond the zenith lead to the other side."""
    places = scattered(50)
    places[:, 1] *= with_light
    scale = 1 if unit == "deg" else math.pi / 180
    columns = {
        "phi_o": places[:, 3],
        "phi": places[:, 3] - places[:, 1],
        "phi_mirror": places[:, 3] - places[:, 1] + 180,
    }
    pairs = []
    for name, azimuths in columns.items():
        angles = {"elevation_i": 90 - places[:, 0], "phi_i": places[:, 1], "elevation_o": 90 + places[:, 2]}
        angles |= {name: azimuths + 180}
        if not with_light:
            del angles["phi_i"]
        table = np.stack([*angles.values()], 1) * scale
        path = tmp_path / f"{name}.csv"
        lines_about(path, places, table, head_of(*angles, unit=unit), MATERIALS["chalk"])
        pairs.append(gonio.read_pairs(path))
    angles = np.radians(places)
    for found in pairs:
        for direction, i in ((found.wi, 0), (found.wo, 2)):
            expected = torch.from_numpy(direction_at_angles(angles[:, i], angles[:, i + 1]))
            torch.testing.assert_close(direction, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        *(("elevation_i_deg", "elevation_i_deg"), ("el_o", "elevation_o"), ("lightAltitude", "elevation_i")),
        *(("incident_zenith", "theta_i"), ("viewZenith_rad", "theta_o_rad"), ("polar angle out", "theta_o")),
        *(("azimuth_in", "phi_i"), ("relative azimuth", "phi"), ("sensor azimuth", "phi_o"), ("azi_deg", "phi_deg")),
        *(("phi_mirror_deg", "phi_mirror_deg"), ("azimuth_from_specular", "phi_mirror")),
        *(("elevation", ""), ("elevation_h", ""), ("theta_mirror", ""), ("el", ""), ("light", ""), ("", "")),
    ],
)
def test_names_of_other_angles(name: str, expected: str) -> None:
    assert name_angle(name) == expected


@pytest.mark.parametrize(
    ("head", "row", "facts"),
    [
        ("theta_in,phi_i_deg,theta_o_deg,phi_o_deg", "30,0,30,180", ("theta_in: no unit", "theta_in_deg")),
        ("thetaI (grad),phi_i_deg,theta_o_deg,phi_o_deg", "30,0,30,180", ("thetaI (grad): no unit", "thetaI_deg")),
        ("alpha,phi_i_deg,theta_o_deg,phi_o_deg", "3,0,3,1", ("'alpha'", "theta_i_deg", "elevation_i_deg")),
        ("theta_i_deg,phi_i_deg,theta_out_deg,phi_o_deg", "30,0,130,180", ("theta_out 130 deg", "elevation_o_deg")),
        ("theta_i_deg,phi_i_deg,el_o_deg,phi_o_deg", "30,0,-5,180", ("el_o -5 deg, expected 0 to 180", "below")),
    ],
)
def test_errors_name_the_columns_of_the_file(tmp_path: Path, head: str, row: str, facts: tuple[str, ...]) -> None:
    (tmp_path / "a.csv").write_text(f"{head},r,g,b\n{row},0.1,0.1,0.1\n")
    with pytest.raises(ValueError, match=r"a\.csv: ") as caught:
        gonio.read_pairs(tmp_path / "a.csv")
    assert says(str(caught.value), *facts)


@pytest.mark.parametrize("place", ["half circle", "turned sample", "plane", "scattered"])
@pytest.mark.parametrize("name", NAMES)
def test_a_single_column_of_radians_among_degrees_is_refused(tmp_path: Path, place: str, name: str) -> None:
    places, index = PLACES[place], NAMES.index(name)
    if not places[:, index].any():
        return
    columns = places.copy()
    columns[:, index] = np.radians(columns[:, index])
    with pytest.raises(ValueError, match=f"{name}_deg up to .*they look like radians: rename .*{name}_rad"):
        lines_about(tmp_path / "a.csv", places, columns, head_of(*NAMES), MATERIALS["clay"])


def test_few_or_small_degrees_are_no_radians(tmp_path: Path) -> None:
    """Lights at 1.5 degrees, an azimuth that was aligned to 0.3, and light beside the normal."""
    places = PLACES["few lights"].copy()
    rng = np.random.default_rng(0)
    for column, values in (
        (0, np.where(places[:, 0] > 30, 1.5, 0.5)),
        (1, rng.normal(0.3, 0.1, len(places))),
        (0, rng.uniform(0, 1.2, len(places))),
    ):
        places[:, column] = values
        assert not lines_about(tmp_path / "a.csv", places, places, head_of(*NAMES), MATERIALS["clay"])


def test_light_that_travels_down_is_refused_with_what_helps(tmp_path: Path) -> None:
    places = PLACES["half circle"]
    columns = places.copy()
    columns[:, 0] = 180 - columns[:, 0]
    with pytest.raises(ValueError, match=r"theta_i 170 deg, .*subtract them from 180 degrees if .*light travels"):
        lines_about(tmp_path / "a.csv", places, columns, head_of(*NAMES), MATERIALS["clay"])
