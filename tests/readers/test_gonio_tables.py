"""Goniometer tables that are not what they say are refused in a line; honest ones, with noise or grooves, are not."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import gonio
from data_tools.readers.brdf_objects import task_of_object
from data_tools.readers.gonio_angles import name_angle
from data_tools.readers.measured_pairs import MeasuredPairs
from data_tools.readers.reciprocity import fit_cosine_power, require_reciprocity
from metapp.appearance.geometry import directions_to_four_angles
from tests.anisotropic import brushed_reflectance, direction_at_angles, random_directions

Doubles = NDArray[np.float64]
HEAD = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"


def isotropic_reflectance(wi: Tensor, wo: Tensor) -> Tensor:
    """Return a BRDF [N, 3] in 1/sr of a body and a lobe, which is reciprocal."""
    theta_h = directions_to_four_angles(wi, wo)[:, :1]
    return torch.tensor([0.13, 0.06, 0.03]) + 0.5 * torch.exp(-((theta_h / 0.3) ** 2)) * (wi + wo).norm(dim=1)[:, None]


def grid_angles(light_azimuths: Doubles, azimuths: Doubles) -> Doubles:
    """Return theta_i, phi_i, theta_o and phi_o of a goniometer that stops at steps, in degrees, [N, 4]."""
    axes = np.meshgrid(np.arange(0, 81, 10.0), light_azimuths, np.arange(0, 81, 5.0), azimuths, indexing="ij")
    theta_i, phi_i, theta_o, phi = (axis.ravel() for axis in axes)
    return np.stack([theta_i, phi_i, theta_o, phi_i + phi], 1)


def random_angles(count: int) -> Doubles:
    columns = []
    for seed in (1, 2):
        x, y, z = random_directions(count, seed, 0.2).T.numpy()
        columns += [np.degrees(np.arccos(z)), np.degrees(np.arctan2(y, x)) % 360]
    return np.stack(columns, 1)


PLACES = {
    "half circle": grid_angles(np.zeros(1), np.arange(0, 181, 15.0)),
    "full circle": grid_angles(np.zeros(1), np.arange(0, 360, 30.0)),
    "turned sample": grid_angles(np.arange(0, 360, 45.0), np.arange(0, 360, 45.0)),
    "scattered": random_angles(3000),
}
MATERIALS = {"isotropic": isotropic_reflectance, "anisotropic": brushed_reflectance}


def measure(places: Doubles, material: str, noise: float = 0.0) -> MeasuredPairs:
    angles = np.radians(places)
    wi, wo = (torch.from_numpy(direction_at_angles(angles[:, i], angles[:, i + 1])) for i in (0, 2))
    values = MATERIALS[material](wi, wo).double()
    draws = torch.randn(len(values), 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return MeasuredPairs(wi, wo, values * torch.exp(noise * draws))


def write(path: Path, head: str, *columns: Doubles | Tensor) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="", fmt="%.7g")
    return path


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("place", PLACES)
def test_honest_tables_are_taken(place: str, material: str, noise: float) -> None:
    require_reciprocity("a.csv", measure(PLACES[place], material, noise))


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (lambda cos_i, cos_o: cos_o, "looks like a BRDF times cos theta_o: divide"),
        (lambda cos_i, cos_o: cos_i, "looks like a BRDF times cos theta_i: divide"),
        (lambda cos_i, cos_o: 1 / cos_i, "if they were divided by cos theta_i, multiply"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.15])
@pytest.mark.parametrize("place", ["half circle", "full circle", "turned sample"])
def test_a_cosine_is_found_by_reciprocity(place: str, noise: float, factor: Callable, words: str) -> None:
    pairs = measure(PLACES[place], "isotropic", noise)
    times_cosine = pairs._replace(reflectance=pairs.reflectance * factor(pairs.wi[:, 2:], pairs.wo[:, 2:]))
    with pytest.raises(ValueError, match=r"^a\.csv: not reciprocal: .*expected the BRDF in 1/sr") as caught:
        require_reciprocity("a.csv", times_cosine)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_few_measurements_are_not_judged() -> None:
    pairs = measure(PLACES["half circle"][500:508], "isotropic")
    assert fit_cosine_power(pairs._replace(reflectance=pairs.reflectance * pairs.wo[:, 2:])) == (0.0, 0)


def test_a_cosine_is_found_before_a_recipe_is_chosen(tmp_path: Path) -> None:
    """Files and arrays; a table that is refused has no say in the choice, which else would be "anisotropic"."""
    places = PLACES["half circle"]
    pairs = measure(places, "isotropic")
    values = pairs.reflectance * pairs.wo[:, 2:]
    file = write(tmp_path / "a.csv", HEAD, places, values)
    (source,), _ = gonio.find(file)
    assert source.facts == {"damaged": True}
    for read in (lambda: gonio.read_task(file), lambda: task_of_object((pairs.wi, pairs.wo, values), "paint")):
        with pytest.raises(ValueError, match="not reciprocal"):
            read()


def read_alike(file: Path, places: Doubles) -> None:
    """Check that a table is read as the isotropic reflectance at `places`."""
    pairs, expected = gonio.read_pairs(file), measure(places, "isotropic")
    for name in ("wi", "wo", "reflectance"):
        torch.testing.assert_close(getattr(pairs, name), getattr(expected, name), rtol=1e-5, atol=1e-5)
    (source,), _ = gonio.find(file)
    assert not source.facts["anisotropic"]


@pytest.mark.parametrize("name", ["phi", "dphi", "delta_phi", "phi_o"])
def test_three_angles_have_the_light_at_azimuth_0(tmp_path: Path, name: str) -> None:
    places = PLACES["half circle"]
    head = f"theta_i_deg,theta_o_deg,{name}_deg,r,g,b"
    file = write(tmp_path / "a.csv", head, places[:, [0, 2, 3]], measure(places, "isotropic").reflectance)
    with pytest.warns(UserWarning, match=r"a\.csv: three angles, .* phi_i is taken as 0, .* = 180 degrees"):
        read_alike(file, places)


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("azimuth", [True, False])
def test_half_and_difference_angles_are_read(tmp_path: Path, unit: str, azimuth: bool) -> None:
    """Rows below the surface, as a full grid of these angles has, are left out."""
    places = PLACES["scattered"]
    pairs = measure(places, "isotropic")
    angles = directions_to_four_angles(pairs.wi, pairs.wo).numpy() * (180 / math.pi if unit == "deg" else 1)
    names = ["theta_h", "theta_d", "phi_d", "phi_h"][: 3 + azimuth]
    head = ",".join([*(f"{name}_{unit}" for name in names), "r,g,b"])
    below = np.array([[80.0, 80.0, 0.0, 0.0]]) * (1 if unit == "deg" else math.pi / 180)
    rows = np.concatenate([angles, below])[:, : len(names)]
    file = write(tmp_path / "a.csv", head, rows, np.concatenate([pairs.reflectance.numpy(), np.zeros((1, 3))]))
    found = gonio.read_pairs(file)
    expected = directions_to_four_angles(pairs.wi, pairs.wo)[:, : len(names)]
    found_angles = directions_to_four_angles(found.wi, found.wo)[:, : len(names)]
    torch.testing.assert_close(found_angles.cos(), expected.cos(), rtol=0, atol=1e-4)
    torch.testing.assert_close(found.reflectance, pairs.reflectance, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        *(("theta_in", "theta_i"), ("thetaI", "theta_i"), ("Theta_incident_deg", "theta_i_deg")),
        *(("phi r", "phi_o"), ("phi_out_radians", "phi_o_rad"), ("theta_v_degrees", "theta_o_deg")),
        *(("theta_half", "theta_h"), ("phi_diff_rad", "phi_d_rad"), ("theta_h", "theta_h"), ("phi", "phi")),
        *(("theta", ""), ("r", ""), ("theta_s", ""), ("phi_i_grad", ""), ("dtheta", "")),
    ],
)
def test_names_of_angles(name: str, expected: str) -> None:
    assert name_angle(name) == expected


def test_tables_of_other_names_are_read(tmp_path: Path) -> None:
    places = PLACES["half circle"]
    values = measure(places, "isotropic").reflectance
    read_alike(
        write(tmp_path / "a.csv", "Theta_in [deg],Phi_in [deg],thetaOut (deg),phi_r_degrees,R,G,B", places, values),
        places,
    )


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ((0, 1, 2, 3), r"theta_i_deg, theta_o_deg up to 1\.\d+, expected degrees .* rename the columns to theta_i_rad"),
        (
            (1, 3),
            r"phi_i_deg, phi_o_deg up to \d\.\d+, expected degrees, .* rename the columns to phi_i_rad, phi_o_rad",
        ),
        ((), ""),
    ],
)
def test_radians_in_columns_of_degrees_are_refused(
    tmp_path: Path, place: str, columns: tuple[int, ...], words: str
) -> None:
    places = PLACES[place].copy() % 360
    values = measure(places, "isotropic").reflectance
    places[:, columns] = np.radians(places[:, columns])
    file = write(tmp_path / "a.csv", HEAD, places, values)
    if not columns:
        gonio.read_pairs(file)
        return
    with pytest.raises(ValueError, match=words):
        gonio.read_pairs(file)


@pytest.mark.parametrize(
    "azimuths",
    [np.zeros(9), np.arange(0, 3.2, 0.1), np.arange(-3, 3.1, 0.25), np.full(9, 180.0), np.array([0, 1.1, 2.3, 3.1])],
)
def test_small_azimuths_of_degrees_are_taken(tmp_path: Path, azimuths: Doubles) -> None:
    """A goniometer that leaves the plane of incidence by some degrees at most."""
    places = grid_angles(np.zeros(1), azimuths)
    gonio.read_pairs(write(tmp_path / "a.csv", HEAD, places, measure(places, "isotropic").reflectance))


def test_degrees_in_columns_of_radians_are_refused(tmp_path: Path) -> None:
    places = PLACES["half circle"]
    file = write(tmp_path / "a.csv", HEAD.replace("deg", "rad"), places, measure(places, "isotropic").reflectance)
    with pytest.raises(ValueError, match=r"theta_i 10 rad, expected .* if these are degrees, rename .* theta_i_deg\.$"):
        gonio.read_pairs(file)


def test_facts_count_what_fits_see(tmp_path: Path) -> None:
    """Repeated measurements are one sample; rows along the surface are none."""
    places = np.tile(PLACES["scattered"][:5], (100, 1))
    values = measure(places, "isotropic", 0.02).reflectance
    (source,), _ = gonio.find(write(tmp_path / "a.csv", HEAD, places, values))
    assert source.facts == {"anisotropic": False, "samples": 5}
    assert gonio.read_task(source.path, source.content).data["angles"].shape == (10, 3)
    places[:, 2] = 90
    with pytest.raises(ValueError, match=r"of all 500 pairs of directions is along or below the surface, expected 4"):
        gonio.read_pairs(write(tmp_path / "b.csv", HEAD, places, values))
