"""Materials as separate maps: which file is what, and how each becomes a map of the renderer."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from data_tools.readers import material_maps, svbrdf_inputs
from data_tools.readers.map_names import parse_map_name
from data_tools.readers.material_maps import entries, find, mixed_slope_correlation, read_task
from data_tools.readers.svbrdf_task import render_flash_photo
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.height_fields import normal_from_height
from tests.found_paths import find_paths
from tests.pictures import assert_refused_in_one_line, write_planes

UP = torch.tensor([0.5, 0.5, 1.0])


def write(path: Path, values: Any, kind: str = "uint8", size: int = 64) -> Path:
    """An image file of planes [C, H, W] in [0, 1], or of one colour."""
    planes = torch.as_tensor(values, dtype=torch.float32)
    planes = planes if planes.ndim == 3 else planes.reshape(-1, 1, 1).expand(-1, size, size)
    return write_planes(path, planes, kind)


def folder(path: Path, **maps: Any) -> Path:
    """Maps of one colour each; those that every material needs unless they are given or None."""
    for role, value in ({"diffuse": 0.5, "normal": UP, "roughness": 0.4} | maps).items():
        if value is not None:
            write(path / f"rock_{role}.png", value)
    return path


def maps_of(path: Path, **options: Any) -> Tensor:
    """The maps of the one material of a folder, float32 [10, S, S]."""
    (source,), _ = find_paths(material_maps.find, path)
    return read_task(source, 64, **options).data["maps"].float()


def values_of(path: Path) -> list[float]:
    """Diffuse, roughness, specular of a material of one colour; of colours the first channel."""
    return maps_of(path)[[3, 6, 7], 5, 7].tolist()


LINEAR_HALF = ((128 / 255 + 0.055) / 1.055) ** 2.4  # of sRGB 0.5 in 8 bit: 0.2159
WORKED: dict[str, tuple[dict[str, Any], tuple[float, float, float]]] = {
    "roughness": ({}, (LINEAR_HALF, 0.4, 0.04)),
    "gloss": ({"roughness": None, "gloss": 0.8}, (LINEAR_HALF, 0.2, 0.04)),
    "smoothness": ({"roughness": None, "smoothness": 0.2}, (LINEAR_HALF, 0.8, 0.04)),
    "both": ({"gloss": 0.2}, (LINEAR_HALF, 0.4, 0.04)),
    "metal": ({"metallic": 1.0}, (0.0, 0.4, LINEAR_HALF)),
    "no metal": ({"metalness": 0.0}, (LINEAR_HALF, 0.4, 0.04)),
    "half a metal": ({"metal": 0.6}, (0.4 * LINEAR_HALF, 0.4, 0.016 + 0.6 * LINEAR_HALF)),
    "specular": ({"specular": 0.5}, (LINEAR_HALF, 0.4, LINEAR_HALF)),
    "specular of a metal": ({"specular": 0.5, "metallic": 0.0}, (LINEAR_HALF, 0.4, 0.04)),
    "white": ({"diffuse": 1.0}, (1.0, 0.4, 0.04)),
    "linear part": ({"diffuse": 10 / 255}, (10 / 255 / 12.92, 0.4, 0.04)),
}


@pytest.mark.parametrize("kind", WORKED)
def test_maps_agree_with_worked_values(tmp_path: Path, kind: str) -> None:
    maps, expected = WORKED[kind]
    assert values_of(folder(tmp_path, **maps)) == pytest.approx(expected, abs=1e-3)


# 0.01 / g is alpha^2, the fourth power of the roughness
def test_the_gloss_of_old_games_is_a_highlight(tmp_path: Path) -> None:
    write(tmp_path / "rock.png", 0.5)
    write(tmp_path / "rock_norm.png", UP)
    for gloss, roughness in {0.0: 1.0, 0.004: 1.0, 0.2: 0.4729, 0.6: 0.3593, 1.0: 0.3162}.items():
        write(tmp_path / "rock_gloss.png", [gloss] * 3)
        assert values_of(tmp_path) == pytest.approx((LINEAR_HALF, roughness, 0.04), abs=1e-3), gloss


@pytest.mark.parametrize(("kind", "suffix"), [("uint16", "png"), ("uint8", "tga"), ("uint8", "jpg"), ("half", "exr"),
                                              ("float", "tif"), ("uint16", "tif")])  # fmt: skip
def test_maps_are_read_in_all_formats(tmp_path: Path, kind: str, suffix: str) -> None:
    is_float = kind in ("half", "float")
    colour = torch.tensor([0.2, 0.4, 0.6])
    write(tmp_path / f"a_albedo.{suffix}", colour if is_float else linear_to_srgb(colour), kind)
    write(tmp_path / f"a_nrm.{suffix}", torch.tensor([0.6, 0.4, 0.9]), kind)
    write(tmp_path / f"a_rough.{suffix}", 0.25, kind)
    maps = maps_of(tmp_path)
    normal = torch.tensor([0.2, -0.2, 0.8]) / 0.72**0.5
    torch.testing.assert_close(maps[:3, 4, 4], normal, atol=0.015, rtol=0)
    torch.testing.assert_close(maps[3:6, 4, 4], colour, atol=0.015, rtol=0)
    assert maps[6, 4, 4].item() == pytest.approx(0.25, abs=0.005)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (-0.6, 0.0, 0.8), (0.36, 0.48, 0.8)])
@pytest.mark.parametrize("is_signed", [True, False])
def test_normals_of_floating_point_may_be_the_vectors(tmp_path: Path, normal: Any, is_signed: bool) -> None:
    bent = torch.tensor(normal)[:, None, None].expand(3, 64, 64).clone()
    bent[0, :8] *= -1
    write(tmp_path / "a_nrm.exr", bent if is_signed else bent / 2 + 0.5, "float")
    write(tmp_path / "a_albedo.png", 0.5)
    write(tmp_path / "a_rough.png", 0.25)
    torch.testing.assert_close(maps_of(tmp_path)[:3, 40, 40], torch.tensor(normal), atol=2e-3, rtol=0)


def test_a_task_is_photographed_by_the_renderer(tmp_path: Path) -> None:
    (source,), _ = find_paths(material_maps.find, folder(tmp_path))
    task = read_task(source, 48)
    assert task.name == "rock"
    assert list(task.data) == list(material_maps.UNITS)
    assert task.data["maps"].shape == (10, 48, 48)
    assert (task.data["photo"].int() - render_flash_photo(task.data["maps"]).int()).abs().max() <= 1  # maps are halves
    assert read_task(source).data["photo"].shape == (3, 256, 256)


def test_alpha_is_left_aside_and_the_central_square_counts(tmp_path: Path) -> None:
    folder(tmp_path, diffuse=[0.5, 0.5, 0.5, 0.1])
    assert values_of(tmp_path)[0] == pytest.approx(LINEAR_HALF, abs=1e-3)
    wide = torch.ones(3, 64, 128)
    wide[..., 32:96] = 0.5
    write(tmp_path / "wide" / "a_diffuse.png", wide)
    write(tmp_path / "wide" / "a_normal.png", UP.reshape(3, 1, 1).expand(3, 100, 200))
    write(tmp_path / "wide" / "a_roughness.png", torch.full((1, 32, 64), 0.3))
    assert maps_of(tmp_path / "wide")[3].max().item() == pytest.approx(LINEAR_HALF, abs=1e-3)


# Names

NAMES: dict[str, tuple[str, str, str | None]] = {  # name, mark, role
    "rock_diff_4k": ("rock", "", "diffuse"),
    "rock-base-color": ("rock", "", "base colour"),
    "Bricks075A_2K-JPG_Color": ("Bricks075A_2K-JPG", "", "base colour"),
    "RockNormal": ("Rock", "", "normal"),
    "rock_nor_gl_1k": ("rock", "", "normal (OpenGL)"),
    "rusty-metal_normal-ogl": ("rusty-metal", "", "normal (OpenGL)"),
    "RockNormalMapOpenGL": ("Rock", "", "normal (OpenGL)"),
    "rock_nor_dx": ("rock", "", "normal (DirectX)"),
    "rock_normals_2048x2048": ("rock", "", "normal"),
    "Rock_NormalMap": ("Rock", "", "normal"),
    "T_Rock_N": ("T_Rock", "", "normal"),
    "T_Rock_BC": ("T_Rock", "", "base colour"),
    "T_Rock_ORM": ("T_Rock", "", "occlusion, roughness, metallic"),
    "rock_arm_1k": ("rock", "", "occlusion, roughness, metallic"),
    "Rock_metallicRoughness": ("Rock", "", "occlusion, roughness, metallic"),
    "rock rough": ("rock", "", "roughness"),
    "metal_roughness": ("metal", "", "roughness"),
    "RockGlossiness": ("Rock", "", "gloss"),
    "rock_f0": ("rock", "", "specular"),
    "Bricks_REFL_3K": ("Bricks", "", "specular"),
    "rock_metalness": ("rock", "", "metallic"),
    "rusty_metal_metalness": ("rusty_metal", "", "metallic"),
    "RustyMetal_METALNESS": ("RustyMetal", "", "metallic"),
    "Metal01_COL_2K_METALNESS": ("Metal01", "METALNESS", "base colour"),
    "Metal01_METALNESS_2K_METALNESS": ("Metal01", "METALNESS", "metallic"),
    "Bricks_COL_VAR1_3K": ("Bricks", "VAR1", "base colour"),
    "Bricks_NRM16_3K": ("Bricks", "", "normal"),
    "hero_Normal.1001": ("hero", "1001", "normal"),
    "hero_Normal_1024": ("hero", "", "normal"),
    "normal": ("", "", "normal"),
    "n": ("n", "", None),
    "rockn": ("rockn", "", None),
    "rock_ao": ("rock", "", ""),
    "rock": ("rock", "", None),
    "photo_1001": ("photo_1001", "", None),
    "eX_cretewall_03b": ("eX_cretewall_03b", "", None),
    "abnormal": ("abnormal", "", None),
}


def test_names_of_files_state_the_role_of_a_map() -> None:
    assert {stem: parse_map_name(stem) for stem in NAMES} == NAMES


PACKED = {  # a colour whose channels are 0.2, 0.6 and 1 (and alpha 0.7): roughness and metallic
    "arm": (0.6, 1.0), "ORM": (0.6, 1.0), "metallicRoughness": (0.6, 1.0), "RMA": (0.2, 0.6), "mra": (0.6, 0.2),
    "MetallicSmoothness": (0.3, 0.2),
}  # fmt: skip


@pytest.mark.parametrize("word", PACKED)
def test_packed_channels_are_read(tmp_path: Path, word: str) -> None:
    roughness, metallic = PACKED[word]
    folder(tmp_path, **{"roughness": None, word: [0.2, 0.6, 1.0, 0.7]})
    specular = 0.04 * (1 - metallic) + LINEAR_HALF * metallic
    assert values_of(tmp_path) == pytest.approx((LINEAR_HALF * (1 - metallic), roughness, specular), abs=3e-3)
    write(tmp_path / "rock_roughness.png", 0.9)  # a file of its own counts
    assert values_of(tmp_path)[1] == pytest.approx(0.9, abs=2e-3)
    if word != "MetallicSmoothness":  # arrays have no alpha
        colours = {"diffuse": torch.full((3,), 0.5), "normal": UP * 2 - 1, word: torch.tensor([0.2, 0.6, 1.0])}
        arrays = {key: colour.expand(64, 64, 3).numpy() for key, colour in colours.items()}
        task = material_maps.task_of_arrays(arrays, "a.b", 64)
        assert task.data["maps"][6, 5, 7].item() == pytest.approx(roughness, abs=2e-3)


def test_variants_and_tiles_share_unmarked_maps(tmp_path: Path) -> None:
    for index in (1, 2):
        write(tmp_path / f"Bricks_COL_VAR{index}_1K.png", index / 4)
        for role, value in (("BaseColor", 0.5), ("Normal", UP), ("Roughness", index / 4)):
            write(tmp_path / f"hero_{role}.100{index}.png", value)
    for role, value in (("NRM", UP), ("GLOSS", 0.5)):
        write(tmp_path / f"Bricks_{role}_1K.png", value)
    folder(tmp_path / "one", diffuse=None, albedo_1001=0.5)
    tasks = {task.name: task.data["maps"][[3, 6], 5, 7] for task in map(read_task, find_paths(find, tmp_path)[0])}
    assert list(tasks) == ["Bricks_VAR1", "Bricks_VAR2", "hero_1001", "hero_1002", "rock"]
    assert tasks["Bricks_VAR1"][0] < tasks["Bricks_VAR2"][0]
    assert [tasks[f"hero_100{index}"][1].item() for index in (1, 2)] == pytest.approx([0.25, 0.5], abs=2e-3)


def test_files_of_unknown_roles_are_named_and_no_materials_or_photos(tmp_path: Path) -> None:
    folder(tmp_path)
    unknown = ["rock.png", "rock_wibble.png", "rock_wibbleRoughness.png"]
    for name in (*unknown, "rocky.png", "rock_ao.png"):
        write(tmp_path / name, 0.5)
    sources, skipped = find_paths(find, tmp_path)
    assert [source.name for source in sources] == ["rock_diffuse.png"]
    assert [Path(line.partition(":")[0]).name for line in skipped] == [*unknown, "rocky.png"]
    sources, skipped = find_paths(svbrdf_inputs.find, tmp_path)
    assert [source.name for source in sources] == ["rock_diffuse.png", "rocky.png"]  # which is a photo
    assert [Path(line.partition(":")[0]).name for line in skipped] == unknown
    (tmp_path / "rock_roughness.png").unlink()
    message = "of rock.png, rock_wibble.png, rock_wibbleRoughness.png the role is unknown: rename it"
    with pytest.raises(ValueError, match=message):
        maps_of(tmp_path)


def test_a_folder_may_hold_several_materials(tmp_path: Path) -> None:
    folder(tmp_path / "box")
    for role in ("BaseColor", "Normal", "Roughness", "AmbientOcclusion"):
        write(tmp_path / "box" / f"Wood{role}.png", UP)
    for role in ("color", "normal", "gloss"):
        write(tmp_path / "deep" / "sand" / f"{role}.png", UP)
    write(tmp_path / "preview of all.png", UP)
    sources, skipped = find_paths(find, tmp_path)
    assert [source.name for source in sources] == ["rock_diffuse.png", "WoodBaseColor.png", "color.png"]
    (line,) = skipped
    assert "preview of all.png: no map under a usual name, expected names such as" in line
    assert material_maps.recognises(tmp_path)
    assert not material_maps.recognises(tmp_path / "preview of all.png")
    assert [read_task(source, 32).name for source in sources] == ["rock", "Wood", "sand"]
    # any map names its material
    assert find_paths(find, tmp_path / "box" / "WoodNormal.png") == ([sources[1]], [])


def test_variants_with_the_same_normals_stay_together(tmp_path: Path) -> None:
    for index in range(10):
        for variant in "ab":
            path = tmp_path / f"m{index}{variant}"
            write(path / "color.png", 0.5)
            write(path / "rough.png", 0.1 * index)
            write(path / "normal.png", torch.tensor([0.5 + 0.02 * index, 0.5, 1.0]))
    groups = {entry.name: entry.group for entry in entries(find_paths(find, tmp_path)[0], [tmp_path], "auto").values()}
    assert groups == {f"m{index}{variant}": f"m{index}a" for index in range(10) for variant in "ab"}


# Normals


def bumps(size: int = 96, seed: int = 0) -> Tensor:
    """Stored normals [3, S, S] of a random height field, y up."""
    rng = torch.Generator().manual_seed(seed)
    small = torch.rand(1, 1, 12, 12, generator=rng)
    height = torch.nn.functional.interpolate(small, (size, size), mode="bicubic", align_corners=False)[0]
    return normal_from_height(height * 12, periodic=False) / 2 + 0.5


def flip_green(stored: Tensor) -> Tensor:
    return torch.stack([stored[0], 1 - stored[1], stored[2]])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [64, 200])
def test_direction_of_green_is_detected_from_a_height_field(tmp_path: Path, seed: int, size: int) -> None:
    stored = bumps(size, seed)
    assert mixed_slope_correlation(stored * 2 - 1) > 0.8
    assert mixed_slope_correlation(flip_green(stored) * 2 - 1) < -0.8
    up = maps_of(folder(tmp_path / "up", normal=stored))[:3]
    down = maps_of(folder(tmp_path / "down", normal=flip_green(stored)))[:3]
    torch.testing.assert_close(up, down, atol=0.02, rtol=0)
    if size == 64:
        torch.testing.assert_close(up, stored * 2 - 1, atol=0.02, rtol=0)


def test_green_points_up_where_nothing_says_otherwise(tmp_path: Path) -> None:
    ridges = bumps()[:, :1].expand(3, 96, 96).clone()
    ridges[1] = 0.7  # the same slope everywhere
    assert mixed_slope_correlation(ridges * 2 - 1) == pytest.approx(0, abs=0.1)
    assert maps_of(folder(tmp_path, normal=ridges))[1].mean() > 0.2


def test_direction_of_green_follows_the_option_then_the_name(tmp_path: Path) -> None:
    stored = torch.tensor([0.5, 0.75, 0.9])
    for role, option, sign in (
        ("normal_gl", "auto", 1), ("normal_dx", "auto", -1), ("normal", "directx", -1),
        ("nor_gl", "directx", -1), ("normal_dx", "opengl", 1), ("normal", "opengl", 1),
    ):  # fmt: skip
        read = maps_of(folder(tmp_path / option / role, **{"normal": None, role: stored}), normals=option)
        assert read[1, 0, 0].item() == pytest.approx(0.53 * sign, abs=0.01), (role, option)
    both = folder(tmp_path / "both", normal=None, nor_gl=stored, nor_dx=flip_green(stored[:, None, None]))
    assert maps_of(both)[1, 0, 0] > 0  # OpenGL counts


# What is refused


BAD: dict[str, tuple[Callable[[Path], object], str]] = {
    "no normal": (
        lambda path: folder(path, normal=None),
        "rock: no normal map (rock_diffuse.png, rock_roughness.png), expected names such as",
    ),
    "two colours": (
        lambda path: folder(path, albedo=0.5), "rock: rock_albedo.png and rock_diffuse.png for base colour, "
    ),
    "other shape": (
        lambda path: write(folder(path) / "rock_normal.png", UP.reshape(3, 1, 1).expand(3, 64, 96)),
        "rock: rock_normal.png 96x64 px and rock_diffuse.png 64x64 px, expected maps of one shape",
    ),
    "no normals": (lambda path: folder(path, normal=0.5), "rock_normal.png: normals with a mean z of 0"),
    "black": (lambda path: folder(path, diffuse=0.0, specular=0.0), "rock: diffuse and specular are black"),
    "no maps": (lambda path: write(path / "photo.png", 0.5), "no maps in this folder (photo.png), expected names such"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_folders_that_are_no_material_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    make, message = BAD[kind]
    make(tmp_path / "in")
    assert_refused_in_one_line(maps_of, tmp_path / "in", message)
