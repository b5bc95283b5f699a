"""USD: a stage that all of usd-core's validators accept and whose material is the one that was fitted."""

import zipfile
from pathlib import Path

import pytest

from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.assets import usd
from tests.surfaces import PROVENANCE, read_stored_values, rock_surface

pxr = pytest.importorskip("pxr", reason='usd-core is not installed: pip install "metapp[export]"')
from pxr import Usd, UsdShade, UsdValidation  # noqa: E402


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    usd.write_usd(rock_surface(), tmp_path / "3 rock", PROVENANCE)
    return tmp_path / "3 rock"


def problems(folder: Path, suffix: str) -> list[str]:
    """What all validators find."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    stage = Usd.Stage.Open(str(folder / f"{folder.name}.{suffix}"))
    return [fault.GetErrorAsString() for fault in UsdValidation.ValidationContext(validators).Validate(stage)]


def test_validators_accept_the_whole_stage_and_find_a_missing_texture(folder: Path) -> None:
    assert {suffix: problems(folder, suffix) for suffix in ("usda", "usdz")} == {"usda": [], "usdz": []}
    names = zipfile.ZipFile(folder / f"{folder.name}.usdz").namelist()
    assert sum(name.endswith(".png") for name in names) == 5
    assert names[0].endswith(".usdc")  # comes first, by the format's specification
    (folder / "textures" / f"{folder.name}_specular.png").unlink()
    assert problems(folder, "usda")


def test_specular_workflow_holds_the_fitted_maps(folder: Path) -> None:
    stage = Usd.Stage.Open(str(folder / f"{folder.name}.usda"))
    material = UsdShade.Material(stage.GetDefaultPrim().GetChild("Material"))
    shader = UsdShade.Shader(material.ComputeSurfaceSource()[0])
    assert shader.GetInput("useSpecularWorkflow").Get() == 1
    maps = rock_surface().maps
    expected = {
        "diffuseColor": (linear_to_srgb(maps.diffuse), "sRGB"),
        "specularColor": (linear_to_srgb(maps.specular), "sRGB"),
        "roughness": (maps.roughness, "raw"),
        "normal": (maps.normal / 2 + 0.5, "raw"),
    }
    for name, (values, space) in expected.items():
        texture = UsdShade.Shader(shader.GetInput(name).GetConnectedSource()[0].GetPrim())
        assert texture.GetInput("sourceColorSpace").Get() == space
        assert texture.GetInput("wrapS").Get() == "repeat"
        file = Path(texture.GetInput("file").Get().resolvedPath)
        assert (read_stored_values(file) - values).abs().max() <= 0.5 / 255 + 1e-6
