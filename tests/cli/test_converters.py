"""What a converter writes is a data set that `metapp data check` finds no fault with, and that fits read."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from data_tools.readers.merl import FILE_BYTES
from metapp.registry import registry
from tests.fuzz import files as made_files
from tests.marked import long

pytestmark = pytest.mark.usefixtures("small_spheres")
FEW = ("--samples", "256")
SMALL = ("--size", "32")
INPUTS: Mapping[str, tuple[Callable[[], list[made_files.Files]], tuple[str, ...]]] = {
    "merl": (made_files.merl_tables, FEW),
    "nbrdf": (made_files.nbrdf_networks, FEW),
    "bsdf": (made_files.rgl_tables, FEW),
    "images": (lambda: made_files.image_files(".png uint8"), SMALL),
    "flash": (lambda: made_files.image_files(".png uint8"), SMALL),
    "maps": (made_files.material_maps, SMALL),
    "materials": (made_files.material_maps, SMALL),
    "domes": (made_files.material_maps, (*SMALL, "--lamps", "4")),
    "strips": (made_files.component_strips, SMALL),
    "laval": (lambda: made_files.image_files(".exr half"), ("--rows", "32")),
}
STEPS_DEGREES = {  # of theta_i, phi_i, theta_o and phi_o: first, last and step
    "half circle": ((0, 80, 10), (0, 0, 1), (0, 80, 5), (0, 180, 15)),
    "full circle": ((0, 75, 15), (0, 0, 1), (0, 75, 15), (0, 360, 20)),
    "turned sample": ((10, 70, 20), (0, 315, 45), (5, 85, 20), (0, 330, 30)),
    "plane": ((0, 85, 5), (0, 0, 1), (-85, 85, 5), (0, 0, 1)),
}


def convert_and_check(metapp: Callable, *words: str | Path) -> None:
    """Convert an input into a set of test tasks, which is checked and, of BRDFs, fitted."""
    converted = metapp("data", *words, "--split", "test", "--out", "set", "--json").json_result
    assert converted["test"]
    checked = metapp("data", "check", "set")
    assert (checked.code, "no problems" in checked.out) == (0, True), checked.err
    if converted["app"] == "brdf":  # fits of other applications take seconds
        fitted = metapp("overfit", "brdf", "--data", "set", "--steps", "1", "--recipe", "quick", "--json")
        assert len(fitted.json_result["tasks"]) == len(converted["test"])


@pytest.mark.parametrize(
    "name", [long(name) if name in ("merl", "nbrdf", "bsdf", "domes") else name for name in INPUTS]
)
def test_what_a_converter_writes_is_a_data_set(metapp: Callable, tmp_path: Path, name: str) -> None:
    make, options = INPUTS[name]
    for file, content in make()[0].items():
        path = tmp_path / "in" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        if name == "merl":
            os.truncate(path, FILE_BYTES)
    convert_and_check(metapp, name, tmp_path / "in", *options)


@pytest.mark.parametrize("is_anisotropic", [False, True])
@pytest.mark.parametrize("grid", STEPS_DEGREES)
def test_a_table_of_whole_degrees_becomes_a_data_set(metapp: Callable, grid: str, is_anisotropic: bool) -> None:
    """Half and difference angles of such grids lie at the ends of their ranges, and beside them by rounding."""
    axes = [np.arange(first, last + 1, step, dtype=float) for first, last, step in STEPS_DEGREES[grid]]
    theta_i, phi_i, theta_o, phi = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    azimuths = np.radians(phi_i + phi_i + phi)
    value = 0.2 + 0.1 * np.cos(np.radians(theta_i - theta_o)) + is_anisotropic * 0.08 * np.cos(azimuths)
    rows = np.column_stack([theta_i, phi_i, theta_o, phi_i + phi, value, value, value])
    head = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"
    np.savetxt("grid.csv", rows, delimiter=",", header=head, comments="", fmt="%.6g")
    convert_and_check(metapp, "gonio", "grid.csv")


def test_each_converter_is_tested() -> None:
    converters = {name.removeprefix("data ") for name in registry().commands if name.startswith("data ")}
    others = {"synth", "cornell", "check", "join", "markers", "rectify", "ball", "lights", "vgg"}
    assert converters - others == {*INPUTS, "gonio"}
