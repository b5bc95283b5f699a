"""Strips of five squares: what they hold, which materials they blend, and that no material is on both sides."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from data_tools.readers import strips, svbrdf_inputs
from data_tools.readers.strips import blended_materials, group_strips, split_strips
from data_tools.readers.svbrdf_task import encode_srgb, render_flash_photo
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from tests.found_paths import find_paths
from tests.pictures import assert_refused_in_one_line
from tests.pictures import write_planes as write


def material(size: int = 64) -> Tensor:
    """Maps [10, S, S] that differ in all channels."""
    rng = torch.Generator().manual_seed(1)
    smooth = torch.nn.functional.interpolate(torch.rand(1, 8, 8, 8, generator=rng), (size, size), mode="bicubic")[0]
    smooth = smooth.clamp(0.05, 1)
    normal = normal_from_height(smooth[:1] * size / 16)
    return pack_maps(Maps(0.8 * smooth[1:4], 0.5 * smooth[4:7], smooth[7:], normal))


def strip(maps: Tensor, photo: Tensor, gamma: float = 1.0) -> Tensor:
    """The five tiles [3, S, 5 S]."""
    at = unpack_maps(maps)
    tiles = [photo, at.normal / 2 + 0.5, at.diffuse, at.roughness.expand(3, -1, -1), at.specular]
    return torch.cat([tile if index == 1 else tile ** (1 / gamma) for index, tile in enumerate(tiles)], -1)


def example(size: int = 64) -> Tensor:
    maps = material(size)
    return strip(maps, torch.rand(3, size, size))


@pytest.mark.parametrize(("kind", "suffix", "tolerance"), [("uint8", "png", 0.005), ("uint16", "png", 6e-4),
                                                            ("half", "exr", 1e-3), ("float", "tif", 6e-4)])  # fmt: skip
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_a_strip_holds_its_maps(tmp_path: Path, kind: str, suffix: str, tolerance: float, gamma: float) -> None:
    maps, photo = material(), torch.rand(3, 64, 64)
    path = write(tmp_path / f"a;b.{suffix}", strip(maps, photo, gamma), kind)
    task = strips.read_task(path, 64, gamma, white=1)
    assert task.name == "a;b"
    assert [*task.data, "predicted"] == list(strips.UNITS)
    assert task.data["maps"].dtype == torch.float16
    torch.testing.assert_close(task.data["maps"].float(), maps, atol=tolerance * gamma * 1.3, rtol=0)
    torch.testing.assert_close(task.data["maps"][:3].float().norm(dim=0), torch.ones(64, 64), atol=1e-3, rtol=0)
    difference = task.data["photo"].int() - encode_srgb(photo).int()
    assert difference.abs().max() <= (1 if tolerance < 1e-3 else 13)  # sRGB is steep near black
    assert difference.abs().float().mean() < 0.5


@pytest.mark.parametrize("white", [0.8, strips.WHITE_RADIANCE, 3.0])
def test_photographs_are_exposed_anew_but_where_they_clip(tmp_path: Path, white: float) -> None:
    maps, photo = material(), 1.2 * torch.rand(3, 64, 64)
    photo[(photo > 0.99) & (photo < 1)] = 1
    path = write(tmp_path / "a.exr", strip(maps, photo.clamp(0, 1)), "float")
    found = srgb_to_linear(strips.read_task(path, 64, white=white).data["photo"].float() / 255)
    clipped = photo >= 1
    assert (found[clipped] == 1).all()
    torch.testing.assert_close(found[~clipped], (photo[~clipped] / white).clamp(0, 1), atol=0.006, rtol=0)


@pytest.mark.parametrize("size", [32, 48, 64, 96])
def test_other_sizes_keep_means_and_unit_normals(tmp_path: Path, size: int) -> None:
    maps = material()
    read = strips.read_task(write(tmp_path / "a.exr", strip(maps, render_flash_photo(maps) / 255), "float"), size)
    assert read.data["maps"].shape == (10, size, size)
    assert read.data["photo"].shape == (3, size, size)
    got = read.data["maps"].float()
    torch.testing.assert_close(got[3:].mean((1, 2)), maps[3:].mean((1, 2)), atol=2e-3, rtol=0)
    torch.testing.assert_close(got[:3].norm(dim=0), torch.ones(size, size), atol=1e-3, rtol=0)
    assert got[2].min() > 0


def predictions(folder: Path, name: str, maps: Tensor) -> Path:
    """Maps [10, S, S] as another method's files."""
    at = unpack_maps(maps)
    images = {"N": at.normal / 2 + 0.5, "D": at.diffuse ** (1 / 2.2), "R": at.roughness.expand(3, -1, -1)}
    for letter, values in (images | {"S": at.specular ** (1 / 2.2)}).items():
        write(folder / f"{name}_{letter}.png", values, "uint16")
    return folder


@pytest.mark.parametrize(("side", "name"), [(48, "7"), (64, "7"), (48, "7;a;b"), (51, "7")])
def test_predicted_maps_lie_over_the_middle_of_a_strip(tmp_path: Path, side: int, name: str) -> None:
    first = (64 - side) // 2
    middle = (..., slice(first, first + side), slice(first, first + side))
    maps, photo = material(), torch.rand(3, 64, 64)
    folder = predictions(tmp_path / "predicted", name, maps[middle])
    path = write(tmp_path / "7;a;b.png", strip(maps, photo), "uint16")
    whole, read = strips.read_task(path, 64), strips.read_task(path, side, predicted=folder)
    assert torch.equal(read.data["maps"], whole.data["maps"][middle])
    assert torch.equal(read.data["photo"], whole.data["photo"][middle])
    assert read.data["predicted"].dtype == torch.float16
    torch.testing.assert_close(read.data["predicted"], read.data["maps"], atol=2e-3, rtol=0)
    assert strips.read_task(path, 32, predicted=folder).data["predicted"].shape == (10, 32, 32)


def test_predicted_maps_that_are_not_whole_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "7;a;b.png", example())
    folder = predictions(tmp_path / "predicted", "7", material(48))
    write(folder / "7_R.png", torch.rand(3, 40, 40))
    for missing, message in (
        ("", "48 x 48, 48 x 48, 40 x 40, 48 x 48 px"),
        ("R", "7_R.png: no such file"),
        ("N", "7_N"),
    ):
        (folder / f"7_{missing}.png").unlink(missing_ok=not missing)
        assert_refused_in_one_line(lambda place: strips.read_task(path, predicted=place), folder, message)


@pytest.mark.parametrize(("side", "size", "wanted"), [(270, 2048, 270), (270, 264, 264), (64, 2048, 256), (64, 32, 32)])
def test_fits_read_strips_and_maps_as_fine_as_they_are(tmp_path: Path, side: int, size: int, wanted: int) -> None:
    maps = material(side)
    path = write(tmp_path / "a.png", strip(maps, torch.rand(3, side, side)))
    for name, values in {"rock": maps[3:6], "rock_norm": maps[:3] / 2 + 0.5, "rock_gloss": maps[6:7, ::2, ::2]}.items():
        write(tmp_path / "rock" / f"{name}.png", values)
    for source in (path, tmp_path / "rock" / "rock.png"):
        task = svbrdf_inputs.read_task(source, size)
        assert (task.data["maps"].shape, task.data["photo"].shape) == ((10, wanted, wanted), (3, wanted, wanted))
    assert strips.read_task(path).data["maps"].shape == (10, 256, 256)  # data sets have one size


# Names

BLENDS = {
    "0000001;PolishedMarbleFloor_01Xmetal_bumpy_squares;1X1": (
        {"PolishedMarbleFloor_01", "metal_bumpy_squares"}, {"PolishedMarbleFloor_01;1", "metal_bumpy_squares;1"},
    ),
    "0000015;brick_uneven_stonesXmetal_bumpy_squares;defaultX0": (
        {"brick_uneven_stones", "metal_bumpy_squares"}, {"brick_uneven_stones;default", "metal_bumpy_squares;0"},
    ),
    "12;box_mixXflax;0X1": ({"box_mix", "flax"}, {"box_mix;0", "flax;1"}),
    "3;leather;default": ({"leather"}, {"leather;default"}),
    "4;eX_wallXwood;0X1": ({"e", "_wall", "wood"}, {"e", "_wall", "wood"}),
    "5;woodXwood;0X1": ({"wood"}, {"wood;0", "wood;1"}),
    "my Xstrip": ({"my Xstrip"}, {"my Xstrip"}),
    "6;X;0": ({"6;X;0"}, {"6;X;0;0"}),
}  # fmt: skip


def test_strip_names_state_components_and_presets() -> None:
    assert {name: blended_materials(Path("in") / f"{name}.png") for name in BLENDS} == BLENDS


def strip_paths(*kinds: tuple[str, str], count: int = 1) -> list[Path]:
    """Strips by materials and presets."""
    return [Path(f"{index:07d}_{i};{a};{b}.png") for i in range(count) for index, (a, b) in enumerate(kinds)]


def materials_by_side(paths: list[Path]) -> dict[str, set[str]]:
    """What the strips of each side are made of; no material is on both sides."""
    found: dict[str, set[str]] = {"train": set(), "test": set()}
    for path, side in split_strips(paths).items():
        found[side] |= blended_materials(path)[0]
    assert not found["train"] & found["test"]
    return found


def test_of_many_components_every_fifth_is_for_tests_whole() -> None:
    paths = strip_paths(*((f"a{i}Xb{i}", "0X0") for i in range(11)), ("a3Xb4", "0X1"), count=2)
    random.Random(0).shuffle(paths)
    assert len(split_strips(paths)) == len(paths)
    # a3, b3, a4, b4 are one component, the largest and so the first in line
    assert materials_by_side(paths)["test"] == {"a2", "b2", "a9", "b9"}
    assert set(group_strips(paths).values()) == {f"a{i}" for i in range(11)} - {"a4"}


def test_published_strips_are_split_by_presets() -> None:
    """Some strips of the published set, by the list that a search over all of them gave."""
    floor, squares, stones = "PolishedMarbleFloor_01", "metal_bumpy_squares", "brick_uneven_stones"
    sides = {
        (f"{floor}X{squares}", "1X1"): "test",
        (f"{stones}X{squares}", "1X1"): "test",
        (f"{squares}X{floor}", "1X2"): "test",
        (f"{floor}X{squares}", "3Xdefault"): "train",
        (f"{stones}X{floor}", "2X3"): "train",
        (f"{squares}X{stones}", "1X0"): None,
        (f"{floor}X{stones}", "1Xdefault"): None,
    }
    paths = strip_paths(*sides)
    assert [split_strips(paths).get(path) for path in paths] == list(sides.values())
    assert len(set(group_strips(paths).values())) == len(paths)
    with pytest.warns(UserWarning, match=r"^2 of 7 strips left out: they blend presets .* keeps all\.$"):
        assert len(strips.entries(paths, [], "auto")) == 5
    assert len(strips.entries(paths, [], "test")) == 7


def test_strips_of_few_components_are_for_training() -> None:
    for paths in (strip_paths(("aXb", "0X0"), count=9), [Path("a.png")], strip_paths(("aXb", "0X0"), ("cXd", "0X0"))):
        assert split_strips(paths) == dict.fromkeys(paths, "train")
        with pytest.warns(
            UserWarning, match=rf"^0 of {len(paths)} strips are for tests: expected 5 .* --split test\.$"
        ):
            assert len(strips.entries(paths, [], "auto")) == len(paths)
    blends = strip_paths(("aXb", "0X0"), ("bXa", "0X1"), count=2)
    assert len(set(group_strips(blends).values())) == 2  # strips of one blend of presets are one group


@pytest.mark.parametrize("seed", range(4))
def test_no_split_has_a_material_on_both_sides(seed: int) -> None:
    rng = random.Random(seed)
    kinds = [(f"m{rng.randrange(20):02d}Xm{rng.randrange(20):02d}", f"{rng.randrange(3)}X0") for _ in range(8)]
    paths = strip_paths(*kinds)
    materials_by_side(paths)
    assert split_strips(paths) == split_strips(paths[::-1])


# What is refused


def changed(change: Callable[[Tensor], Tensor], name: str = "a.exr") -> Callable[[Path], Path]:
    return lambda folder: write(folder / name, change(example()), "float" if name.endswith("exr") else "uint8")


def set_to(value: float, tiles: tuple[int, ...]) -> Callable[[Tensor], Tensor]:
    def change(values: Tensor) -> Tensor:
        return values.unflatten(-1, (5, 64)).index_fill(-2, torch.tensor(tiles), value).flatten(-2)

    return change


BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "four tiles": (changed(lambda values: values[..., :256]), "256x64 px, 4 tiles, expected 5 squares"),
    "not square": (changed(lambda values: values[:, :45]), "320x45 px, tiles of 64x45 px, expected 5 squares"),
    "black": (changed(set_to(0, (2, 4)), "a.png"), "diffuse and specular are black"),
    "flat gray": (changed(set_to(0.5, (1,))), "normals with a mean z of 0.00, expected 0.3 or more"),
}


@pytest.mark.parametrize("kind", BAD)
def test_files_that_are_no_strip_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    make, message = BAD[kind]
    assert_refused_in_one_line(strips.read_task, make(tmp_path), message)


# What fits read


def test_fits_read_strips_maps_and_photographs(tmp_path: Path) -> None:
    maps = material()
    write(tmp_path / "strip.png", strip(maps, torch.rand(3, 64, 64)))
    write(tmp_path / "off by one.png", example()[..., :-1])
    write(tmp_path / "phone.jpg", torch.rand(3, 60, 80))
    write(tmp_path / "wood_color.jpg", torch.rand(3, 60, 80))  # alone: a photograph that is called so
    write(tmp_path / "rock" / "rock.png", maps[3:6])
    write(tmp_path / "rock" / "rock_norm.png", maps[:3] / 2 + 0.5)
    write(tmp_path / "rock" / "rock_gloss.png", maps[6:7])
    assert svbrdf_inputs.recognises(tmp_path)
    sources, skipped = find_paths(svbrdf_inputs.find, tmp_path)
    assert skipped == []
    tasks = {source.name: svbrdf_inputs.read_task(source, 64) for source in sources}
    mapped = {name: ["maps", "photo"] for name in ("off by one.png", "rock.png", "strip.png")}
    photographed = {name: ["photo"] for name in ("phone.jpg", "wood_color.jpg")}
    assert {name: sorted(task.data) for name, task in tasks.items()} == mapped | photographed
    assert tasks["off by one.png"].name == "off by one"
    assert tasks["phone.jpg"].data["photo"].shape == (3, 64, 64)
    assert tasks["phone.jpg"].data["photo"].dtype == torch.uint8
    torch.testing.assert_close(tasks["strip.png"].data["maps"].float(), maps, atol=0.006, rtol=0)
    assert [strips.is_strip(tmp_path / name) for name in ("strip.png", "phone.jpg")] == [True, False]
    with pytest.raises(ValueError, match=r"none.png: no such file"):
        svbrdf_inputs.read_task(tmp_path / "none.png")
