"""Reading image files: every kind a user may have, and one line for each that cannot be used."""

import base64
import math
import os
import random
import struct
import subprocess
import sys
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import torch
from PIL import Image

from data_tools.readers import flash_photos, square_photos, svbrdf_inputs
from data_tools.readers.flash_photos import entry_of_photo
from data_tools.readers.image_files import Pixels, pixels_of_pil
from data_tools.readers.square_photos import (
    field_of_view_rad,
    find,
    flash_view,
    is_photo,
    narrow_view_height,
    read_photo,
    recognises,
)
from data_tools.readers.svbrdf_inputs import read_task
from data_tools.readers.svbrdf_task import correct_exposure, encode_srgb
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.storage.shards import ManifestEntry, split_auto
from tests.cli.messages import says
from tests.found_paths import find_paths
from tests.pictures import (
    STORED_BY_ORIENTATION,
    assert_refused_in_one_line,
    channels_first,
    noise_image,
    truncate_file,
    write_exr,
    write_image,
    write_text,
)

# 32 x 32 px, quality 60, as Photoshop stores inks: red over blue on the left, green on the right
CMYK = base64.b64decode(
    "/9j/7gAOQWRvYmUAZAAAAAAA/9sAQwANCQoLCggNCwoLDg4NDxMgFRMSEhMnHB4XIC4pMTAuKS0sMzpKPjM2RjcsLUBXQUZMTlJT"
    "UjI+WmFaUGBKUVJP/8AAFAgAIAAgBEMRAE0RAFkRAEsRAP/EABgAAQEBAQEAAAAAAAAAAAAAAAAHBQYI/8QAFBABAAAAAAAAAAAA"
    "AAAAAAAAAP/aAA4EQwBNAFkASwAAPwCnJgmCnADz2vbsQAehEEccADz2vbsQAYyCLYADZXtEwAYyCLYADZXtEwAf/9k="
)


def smooth(height: int, width: int) -> np.ndarray:
    """A picture that JPEG keeps, uint8 [height, width, 3], without any symmetry."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    return (255 * np.stack([x, y, (x + 2 * y) / 3], axis=-1)).astype(np.uint8)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(path: Path, values: np.ndarray, colours: bytes = b"") -> Path:
    """A PNG file by hand: uint8 [height, width, 3], or [height, width, 1] indices into RGB colours."""
    header = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], 8, 3 if colours else 2, 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in values)
    extra = chunk(b"PLTE", colours) if colours else b""
    body = chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


# What is read


def test_bits_are_kept_as_far_as_formats_keep_them(tmp_path: Path) -> None:
    values = noise_image(48, 48)
    deep = values.astype(np.uint16) * 257
    stored = {"a.png": values, "a.tif": values, "a.bmp": values, "a.tga": values, "a.ppm": values}
    for name, content in (stored | {"deep.png": deep, "deep.tif": deep}).items():
        image = read_photo(write_image(tmp_path / name, content), 48)
        assert (image.dtype, image.is_contiguous()) == (torch.uint8, True), name
        assert torch.equal(image, channels_first(values)), name
    values = smooth(64, 64)
    for suffix in ("jpg", "jp2", "webp"):
        image = read_photo(write_image(tmp_path / f"a.{suffix}", values), 64)
        assert (image.float() - channels_first(values).float()).abs().mean() < 2.5, suffix


@pytest.mark.parametrize(("suffix", "kind"), [("exr", "half"), ("exr", "float"), ("hdr", "float"), ("tif", "float")])
def test_floats_are_linear_and_clamped(tmp_path: Path, suffix: str, kind: str) -> None:
    values = np.random.default_rng(0).random((48, 48, 3), dtype=np.float32) * 1.5 - 0.1 * (suffix != "hdr")
    image = read_photo(write_image(tmp_path / f"a.{suffix}", values, kind), 48)
    expected = linear_to_srgb(channels_first(values).clamp(0, 1)) * 255
    difference = (image.float() - expected).abs()
    assert difference.mean() < 1 if suffix == "hdr" else difference.max() < 1  # RGBE shares an exponent


def test_averages_are_over_exact_areas_in_linear_light(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((80, 80, 3), dtype=np.float32)
    image = read_photo(write_image(tmp_path / "a.exr", values), 32)
    # a pixel covers 2.5 x 2.5 of the file's: repeating these twice makes it 5 x 5
    exact = (
        channels_first(values)
        .repeat_interleave(2, 1)
        .repeat_interleave(2, 2)
        .unfold(1, 5, 5)
        .unfold(2, 5, 5)
        .mean((3, 4))
    )
    assert (image - linear_to_srgb(exact) * 255).abs().max() < 0.51
    values = np.zeros((64, 64, 3), np.float32)
    values[:, ::2] = 1000.0
    values[:32] /= 2000.0
    image = read_photo(write_image(tmp_path / "a.exr", values), 32)
    assert image[0, 24, 5] == round(float(linear_to_srgb(torch.tensor(0.5))) * 255)
    assert image[0, 5, 5] == round(float(linear_to_srgb(torch.tensor(0.25))) * 255)


def test_gray_and_layers_go_by_their_channels(tmp_path: Path) -> None:
    values = noise_image(48, 48, 1)
    for name in ("a.png", "a.tif"):
        assert torch.equal(
            read_photo(write_image(tmp_path / name, values), 48), channels_first(values).expand(3, -1, -1)
        )
    assert read_photo(write_image(tmp_path / "a.jpg", values), 48).unique(dim=0).shape[0] == 1
    values = values[..., 0].astype(np.float32)[..., None] / 255
    assert read_photo(write_image(tmp_path / "a.exr", values), 48).unique(dim=0).shape[0] == 1
    values = np.random.default_rng(0).random((48, 48, 4), dtype=np.float32)
    write_image(tmp_path / "a.exr", values, names=("B", "G", "R", "Z"))
    expected = linear_to_srgb(channels_first(values[..., 2::-1])) * 255
    assert (read_photo(tmp_path / "a.exr", 48) - expected).abs().max() < 0.51


def test_inks_and_palettes_become_rgb(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(CMYK)
    image = read_photo(tmp_path / "a.jpg", 32).int()
    for (row, column), colour in {(8, 8): (255, 0, 0), (24, 8): (0, 0, 255), (8, 24): (40, 200, 80)}.items():
        assert (image[:, row, column] - torch.tensor(colour)).abs().max() <= 2
    indices = noise_image(40, 40, 1) % 4
    colours = noise_image(4, 1, 3, seed=1)
    image = read_photo(png(tmp_path / "a.png", indices, colours.tobytes()), 40)
    assert torch.equal(image, channels_first(colours[indices[..., 0], 0]))


def test_half_transparent_photos_are_said(tmp_path: Path) -> None:
    for number, (alpha, share) in enumerate(((128, 0.5), (128, 0.02), (255, 1.0), (0, 0.5))):
        values = np.concatenate([noise_image(64, 64), np.full((64, 64, 1), 255, np.uint8)], axis=-1)
        middle = slice(32 - round(16 * share), 32 + round(16 * share))  # inside, so that no border is cut off
        values[middle, :, 3] = alpha
        path = write_image(tmp_path / f"{number}.png", values)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            read_photo(path, 48)
        lines = [str(warning.message) for warning in caught]
        if (alpha, share) == (128, 0.5):
            assert says(lines[0], path.name, "25% of the px", "half-transparent", "alpha", "their colours are taken")
        assert len(lines) == ((alpha, share) == (128, 0.5))


@pytest.mark.parametrize("name", ["straight.png", "straight.tif", "multiplied.exr"])
def test_transparent_parts_get_the_mean_colour_of_the_rest(tmp_path: Path, name: str) -> None:
    values = np.concatenate([noise_image(48, 48), np.full((48, 48, 1), 255, np.uint8)], axis=-1)
    values[24:, :, 3] = 0
    values[30:, :, :3] = (255, 0, 255)  # what is not seen does not count
    values[20:24, :, 3] = 51
    colours, alpha = (
        srgb_to_linear(channels_first(values[..., :3]).double() / 255),
        channels_first(values[..., 3:]).double() / 255,
    )
    mean = (colours * alpha).sum((1, 2)) / alpha.sum()
    expected = linear_to_srgb(torch.where(alpha > 0, colours, mean[:, None, None])) * 255
    if name.endswith("exr"):
        floats = torch.cat([colours * alpha, alpha]).permute(1, 2, 0).float().numpy()
        write_image(tmp_path / name, floats, **{"oiio:UnassociatedAlpha": 0})
    else:
        write_image(tmp_path / name, values)
    assert (read_photo(tmp_path / name, 48) - expected).abs().max() < 0.51


def test_gloss_or_height_in_alpha_does_not_change_colours(tmp_path: Path) -> None:
    colours = noise_image(48, 48)
    plain = read_photo(write_image(tmp_path / "plain.png", colours), 48)
    for name, alpha in (
        ("even.png", np.full((48, 48, 1), 128, np.uint8)),
        ("height.png", 100 + noise_image(48, 48, 1) // 2),
    ):
        photo = read_photo(write_image(tmp_path / name, np.concatenate([colours, alpha], axis=-1)), 48)
        assert (photo.int() - plain.int()).abs().max() <= 1


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_pictures_are_turned_upright(tmp_path: Path, orientation: int, suffix: str) -> None:
    upright = smooth(96, 48)
    stored = np.ascontiguousarray(STORED_BY_ORIENTATION[orientation](upright))
    image = read_photo(write_image(tmp_path / f"a.{suffix}", stored, Orientation=orientation), 48)
    assert (image.float() - channels_first(upright[24:72]).float()).abs().mean() < 3


def test_the_suffix_may_be_wrong_or_missing(tmp_path: Path) -> None:
    values = noise_image(48, 48)
    written = write_image(tmp_path / "a.png", values).read_bytes()
    for name in ("b.jpg", "c", "d.photo"):
        (tmp_path / name).write_bytes(written)
        assert is_photo(tmp_path / name)
        assert torch.equal(read_photo(tmp_path / name, 48), channels_first(values))


# How it is scaled


def test_the_central_square_counts(tmp_path: Path) -> None:
    values = noise_image(50, 90)
    assert torch.equal(read_photo(write_image(tmp_path / "a.png", values), 50), channels_first(values[:, 20:70]))
    values = np.ascontiguousarray(values.swapaxes(0, 1))
    assert torch.equal(read_photo(write_image(tmp_path / "b.png", values), 50), channels_first(values[20:70]))
    path = write_image(tmp_path / "a.jpg", smooth(300, 200))
    assert torch.equal(read_photo(path), read_photo(path))
    assert read_photo(path).shape == (3, 256, 256)


@pytest.mark.parametrize("reader", [square_photos, flash_photos, svbrdf_inputs])
def test_a_note_says_what_was_cut_and_scaled(reader: Any, tmp_path: Path) -> None:
    for height, width, note in (
        (300, 1200, "1,200 x 300 px: the central 300 x 300 px, scaled to 256 x 256"),
        (256, 280, "280 x 256 px: the central 256 x 256 px"),
        (300, 300, "300 x 300 px, scaled to 256 x 256"),
        (256, 256, ""),
    ):
        assert reader.read_task(write_image(tmp_path / "train_1_a b.png", noise_image(height, width)))[::3] == (
            "train_1_a b",
            note,
        )


def test_smaller_pictures_are_interpolated_only_as_far_as_asked(tmp_path: Path) -> None:
    image = read_photo(write_image(tmp_path / "a.png", smooth(40, 40)), 160).int()
    assert image.shape == (3, 160, 160)
    assert image.diff(dim=2)[0].unique().numel() <= 4  # no blocks
    assert (image.float().mean((1, 2)) - channels_first(smooth(40, 40)).float().mean((1, 2))).abs().max() < 1
    for side, read in ((48, 64), (100, 100), (300, 128)):
        picture = np.arange(side * side * 3, dtype=np.uint32).reshape(side, side, 3) % 251
        write_image(tmp_path / "a.png", picture.astype(np.uint8))
        assert read_photo(tmp_path / "a.png", 128, least=64).shape == (3, read, read)


# What is refused, in one line


def oversized_png(path: Path) -> None:
    """A PNG file of 2^28 + 2^14 px, without any of them."""
    png(path, np.empty((2**14 + 1, 2**14, 0), np.uint8))


def halved(path: Path) -> None:
    truncate_file(
        write_image(path, noise_image(99, 99).astype(np.float32) if path.suffix == ".exr" else noise_image(99, 99))
    )


def two_channels(path: Path) -> None:
    write_image(path, noise_image(64, 64, 2), **{"oiio:UnassociatedAlpha": 0})


WORDS = "a texture, in words\n"
FLOATS = noise_image(64, 64).astype(np.float32)
WITH_NAN = np.where(np.arange(64 * 64 * 3).reshape(64, 64, 3) == 77, np.float32(np.nan), FLOATS / 300)
Content = np.ndarray | str | Callable[[Path], object] | None
BAD: dict[str, tuple[str, Content, str]] = {
    "missing": ("a.jpg", None, "a.jpg: no such file, expected an image file"),
    "text": ("a.jpg", WORDS, "a.jpg: not an image (not a JPEG file, magic number"),
    "text without suffix": ("a", "in words", "a: not an image (OpenImageIO could not find a format reader), expected"),
    "empty": ("a.png", "", "a.png: not an image ("),
    "truncated jpg": ("a.jpg", halved, "a.jpg: damaged or incomplete"),
    "1x1": ("a.png", noise_image(1, 1), "1x1 px, expected 32 px or more on the short side"),
    "oversized": ("a.png", oversized_png, "16384x16385 px, expected 268,435,456 px or fewer"),
    "black": ("a.png", 0 * noise_image(64, 64), "one colour all over (standard deviation 0.0"),
    "glaring": ("a.exr", 2 + FLOATS, "values up to 257, most above 1, which is white, expected values in [0, 1];"),
    "NaN": ("a.exr", WITH_NAN, "holds NaN, expected finite values"),
    "transparent": ("a.png", noise_image(64, 64, 4) * np.uint8([1, 1, 1, 0]), "transparent all"),
    "deep": (
        "a.exr",
        lambda path: write_exr(path, ("deep:R G B A", noise_image(48, 48, 4))),
        "a deep image, expected one colour a pixel",
    ),
    "two channels": ("a.tif", two_channels, "channels "),
    "raw": (
        "a.dng",
        lambda path: write_image(path.with_suffix(".tif"), noise_image(64, 64)).rename(path),
        "raw values of a camera, expected an image file, such as JPEG, PNG, TIFF or EXR; develop it and export it "
        "as JPEG or PNG.",
    ),
    "heic": ("a.HEIC", WORDS, "a picture in HEIF or AVIF, expected an image file, such as JPEG"),
}


@pytest.mark.parametrize("kind", BAD)
def test_unusable_files_are_refused_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str) -> None:
    name, content, message = BAD[kind]
    path = tmp_path / name
    if isinstance(content, np.ndarray):
        write_image(path, content)
    elif isinstance(content, str):
        path.write_text(content)
    elif content:
        content(path)
    assert_refused_in_one_line(lambda path: read_photo(path, 48), path, message)
    assert capfd.readouterr() == ("", "")  # image libraries write to the screen by themselves


@pytest.mark.parametrize("name", [b"\xff.png", b"\xff"])
def test_names_that_are_not_utf8_are_refused_in_one_line(tmp_path: Path, name: bytes) -> None:
    path = write_image(tmp_path / "a.png", noise_image(64, 64)).rename(tmp_path / os.fsdecode(name))
    with pytest.raises(ValueError, match=r"^'[ -~]*': a name that is not UTF-8, expected one that is; rename it\.$"):
        read_photo(path, 48)
    assert is_photo(path) == (name != b"\xff")


@pytest.mark.long
def test_no_message_is_printed_when_python_ends(tmp_path: Path) -> None:
    write_text(tmp_path / "bad.jpg")
    write_text(tmp_path / "bad")
    write_image(tmp_path / "good.png", noise_image(64, 64))
    lines = (
        "import sys\nfrom pathlib import Path\nfrom data_tools.readers.square_photos import find_images, read_photo\n"
    )
    lines += "for file in find_images(Path(sys.argv[1]))[0]:\n    try:\n        kept = read_photo(file)\n"
    lines += "    except ValueError as error:\n        last = error\n"
    process = subprocess.run([sys.executable, "-c", lines, tmp_path], capture_output=True, text=True, check=True)
    assert (process.stdout, process.stderr) == ("", "")


# What is found


def test_folders_are_searched_at_any_depth(tmp_path: Path) -> None:
    for name in ("b.JPG", "a.png", "deep/er/c.tiff", ".hidden/d.png", "deep/.e.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    write_image(tmp_path / "deep" / "picture.png", noise_image(32, 32)).rename(tmp_path / "deep" / "picture")
    write_text(tmp_path / "notes.txt")
    write_text(tmp_path / "metadata.json")
    files, skipped = find_paths(find, tmp_path)
    assert [str(file.relative_to(tmp_path)) for file in files] == ["a.png", "b.JPG", "deep/er/c.tiff", "deep/picture"]
    assert [line.split(":")[0].rpartition("/")[2] for line in skipped] == ["notes.txt"]
    assert find_paths(find, tmp_path / "notes.txt") == ([tmp_path / "notes.txt"], [])  # reading it says what is wrong
    for name, holds in {"": True, "deep/picture": True, "notes.txt": False, "nothing": False}.items():
        assert recognises(tmp_path / name) == holds, name


def test_raw_and_heif_files_are_recognised_to_be_explained(tmp_path: Path) -> None:
    for name in ("a.dng", "b.CR2", "c.heic", "d.HEIF"):
        assert is_photo(write_text(tmp_path / name))
        assert recognises(tmp_path / name)
    assert not is_photo(tmp_path / "none.heic")
    assert recognises(tmp_path)
    with pytest.raises(ValueError, match=r"a\.dng: raw values of a camera, .*; develop it and export it as JPEG .*\.$"):
        find(tmp_path)
    jpg = write_image(tmp_path / "a.jpg", noise_image(48, 48))  # a camera may write both
    renamed = write_image(tmp_path / "e.jpg", noise_image(48, 48)).rename(tmp_path / "e.heic")  # and a suffix be wrong
    files, skipped = find_paths(find, tmp_path)
    assert files == [jpg, renamed]
    raw, heif = "raw values of a camera", "a picture in HEIF or AVIF"
    whys = {"a.dng": raw, "b.CR2": raw, "c.heic": heif, "d.HEIF": heif}
    assert [line.partition(",")[0] for line in skipped] == [f"{tmp_path / name}: {why}" for name, why in whys.items()]


def test_folders_without_images_and_bombs_are_refused(tmp_path: Path) -> None:
    write_text(tmp_path / "notes.txt")
    assert not recognises(tmp_path)
    with pytest.raises(ValueError, match=r"no image in this folder, expected an image file"):
        find(tmp_path)
    with pytest.raises(ValueError, match=r"none.jpg: no such file, expected an image file"):
        find(tmp_path / "none.jpg")
    (tmp_path / "bomb.ppm").write_bytes(b"P6\n16384 16384\n255\n" + bytes(1000))
    with pytest.raises(ValueError, match=r"bomb.ppm: 16384x16384 px of 3 channels in 1,\d+ bytes"):
        read_photo(tmp_path / "bomb.ppm")


# Photographs as tasks


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def splits_of(folder: Path) -> dict[str, str]:
    """The split of each photograph of a folder, by the name of its task."""
    found = flash_photos.entries(find_paths(flash_photos.find, folder)[0], [folder], "auto").values()
    by_group = split_auto(sorted(entry.group for entry in found))
    return {entry.name: entry.split or by_group[entry.group] for entry in found}


PLACES = {
    ("train_0231_IMG_0785.jpg", ""): ("0231_IMG_0785", "0231", "train"),
    ("deep/Test_gold_a.jpg", ""): ("gold_a", "gold", "test"),
    ("test/0280/IMG_0786.JPG", ""): ("0280_IMG_0786", "0280", "test"),
    ("Train/tin.jpg", ""): ("tin", "tin", "train"),
    ("box/wood/IMG_1.jpg", ""): ("wood_IMG_1", "wood", ""),
    ("stone.jpg", ""): ("stone", "stone", ""),
    ("test_stone.jpg", ""): ("test_stone", "test_stone", ""),
    # what lies above the named folder says nothing, but the folder itself does, and the place of a file that was named
    ("test/photographs/wood/a.jpg", "test/photographs"): ("wood_a", "wood", ""),
    ("test/gold/a.jpg", "test"): ("gold_a", "gold", "test"),
    ("test/gold/a.jpg", None): ("gold_a", "gold", "test"),
    ("photographs/a.jpg", None): ("a", "a", ""),
}


@pytest.mark.parametrize(("file", "named"), PLACES)
def test_the_material_follows_from_name_and_place(tmp_path: Path, file: str, named: str | None) -> None:
    where = () if named is None else (tmp_path / named,)
    name, group, split = PLACES[file, named]
    assert entry_of_photo(tmp_path / file, *where) == ManifestEntry(name, group=group, split=split)


@pytest.mark.parametrize(
    "layout", ["train_{material}_{image}.jpg", "{material}/{image}.jpg", "train/{material}/{image}.jpg"]
)
def test_every_fifth_material_is_for_tests_whole(tmp_path: Path, layout: str) -> None:
    rng = random.Random(0)
    counts = {f"m{i:02d}": rng.randint(1, 4) for i in range(23)}
    for material, count in counts.items():
        touch(tmp_path, *(layout.format(material=material, image=f"i{image}") for image in range(count)))
    split = splits_of(tmp_path)
    assert len(split) == sum(counts.values())
    sides = {side: {name.partition("_")[0] for name in split if split[name] == side} for side in ("train", "test")}
    assert sides["test"] == {"m04", "m09", "m14", "m19"}
    assert sides["train"] == set(counts) - sides["test"]
    assert splits_of(tmp_path) == split


def test_stated_splits_hold_where_both_occur(tmp_path: Path) -> None:
    touch(tmp_path, "test_a_1.jpg", "test_a_2.jpg", "train_b_1.jpg", "test/c/1.jpg", "train/d.jpg", "metadata.json")
    assert splits_of(tmp_path) == {"a_1": "test", "a_2": "test", "b_1": "train", "c_1": "test", "d": "train"}
    assert find_paths(flash_photos.find, tmp_path)[1] == []
    touch(tmp_path, "e.jpg")  # one that says nothing: the rule decides on all
    assert {name for name, side in splits_of(tmp_path).items() if side == "test"} == {"e"}


def test_a_material_on_both_sides_and_bad_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no image in this folder"):
        flash_photos.find(tmp_path)
    with pytest.raises(ValueError, match=r"none.jpg: no such file"):
        flash_photos.find(tmp_path / "none.jpg")
    touch(tmp_path, "train_a_1.jpg", "test_a_2.jpg")
    with pytest.raises(ValueError, match=r"test_a_2.jpg and .*train_a_1.jpg: training and test .* material 'a'"):
        splits_of(tmp_path)


def photo(path: Path, focal: int = 0, height: int = 96, width: int = 128) -> Path:
    """A ramp along both axes, so that every crop is another picture."""
    y, x = np.mgrid[:height, :width]
    attributes = {"Exif:FocalLengthIn35mmFilm": focal} if focal else {}
    return write_image(path, np.uint8(np.stack([x + 40, 2 * y + 20, 100 + 0 * x], -1)), **attributes)


def test_fields_of_view_of_known_lenses() -> None:
    """50 mm and 24 mm on film, 24 mm along the shorter side; a phone's main and wide lens, of pictures 4:3."""
    lenses = {(50, 24, 36): 26.99, (24, 36, 24): 53.13, (26, 3024, 4032): 53.07, (13, 3024, 4032): 89.91}
    found = {lens: math.degrees(field_of_view_rad(*lens)) for lens in lenses}
    assert found == pytest.approx(lenses, abs=0.05)
    whole = Pixels(np.zeros((1000, 1200, 3), np.uint8), "", False)
    sides = {degrees: len(flash_view(whole, math.radians(degrees)).values) for degrees in (0, 30, 45, 90)}
    assert sides == {0: 1000, 30: 1000, 45: 1000, 90: 414}  # nothing can be added
    heights = {degrees: narrow_view_height(whole, math.radians(degrees)) for degrees in (0, 30, 45, 90)}
    assert heights == pytest.approx({0: 0, 30: 1 / math.tan(math.radians(15)), 45: 0, 90: 0})


def test_photos_of_narrow_lenses_tell_how_high_their_flash_was(tmp_path: Path) -> None:
    narrow, wide, unknown = (photo(tmp_path / f"{focal}.jpg", focal=focal) for focal in (75, 26, 0))
    height = 1 / math.tan(field_of_view_rad(75, 96, 128) / 2)
    expected = torch.tensor([0.0, 0.0, height]).expand(1, 2, 3)
    torch.testing.assert_close(svbrdf_inputs.read_task(narrow).data["places"], expected)
    assert "places" not in svbrdf_inputs.read_task(wide).data
    assert "places" not in svbrdf_inputs.read_task(unknown).data
    stated = svbrdf_inputs.read_task(unknown, fov_rad=math.radians(20)).data["places"]
    assert float(stated[0, 0, 2]) == pytest.approx(1 / math.tan(math.radians(10)))
    assert "places" not in svbrdf_inputs.read_task(narrow, fov_rad=math.radians(60)).data


@pytest.mark.parametrize("suffix", ["jpg", "tif", "png"])
def test_photos_of_wide_lenses_are_cropped_to_the_fits_camera(tmp_path: Path, suffix: str) -> None:
    path = photo(tmp_path / f"a.{suffix}", focal=26)
    share = math.tan(math.radians(22.5)) / math.tan(field_of_view_rad(26, 96, 128) / 2)
    side = round(96 * share)
    assert 76 < side < 82
    found = flash_photos.read_task(path, side).data["image"].float()
    low = (128 - side) // 2 + 40
    assert (found[0].mean() - (low + (side - 1) / 2)).abs() < 1
    assert (found[0, side // 2, -1] - found[0, side // 2, 0] - (side - 1)).abs() < 3
    assert torch.equal(svbrdf_inputs.read_task(path, side).data["photo"].float(), found)


def test_fields_of_view_follow_the_user_then_the_file(tmp_path: Path) -> None:
    wide, plain = photo(tmp_path / "a.png", focal=26), photo(tmp_path / "b.png")
    output = [flash_photos.read_task(path, 64, math.radians(70)).data["image"] for path in (wide, plain)]
    assert torch.equal(*output)
    assert not torch.equal(output[0], flash_photos.read_task(wide, 64).data["image"])
    texture = photo(tmp_path / "c.png", focal=13)
    whole = square_photos.read_task(plain, 96).data["image"]
    assert torch.equal(flash_photos.read_task(plain, 96).data["image"], whole)
    assert torch.equal(square_photos.read_task(texture, 96).data["image"], whole)  # no flash, no camera


@pytest.mark.parametrize("exif", [b"", b"Exif\0\0", b"Exif\0\0II*\0\xff\xff\xff\xff", b"nonsense" * 9])
def test_damaged_exif_is_ignored(exif: bytes) -> None:
    picture = Image.fromarray(noise_image(48, 48))
    picture.info["exif"] = exif
    assert pixels_of_pil(picture, "a").lens.focal_mm == 0


# Photographs that were exposed wrongly, as if they had been exposed rightly


RADIANCE = 0.02 + 0.9 * torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))


def linear(photo: torch.Tensor) -> torch.Tensor:
    return srgb_to_linear(photo.float() / 255)


@pytest.mark.parametrize("stops", [-2.0, -1.0, -0.3, 0.5, 1.0, 2.0])
def test_a_photo_is_exposed_anew_but_where_it_clips(stops: float) -> None:
    photo = encode_srgb(RADIANCE * 2**stops)
    found, clips = correct_exposure(photo, stops), (linear(photo) > 0.95).any(0)
    assert clips.any() == (stops > 0)
    assert not clips.all()
    assert torch.equal(found[:, clips], photo[:, clips])
    # half a step of 8 bits, at most 0.0044 of radiance, in the photo and in what it becomes
    tolerance = 0.0045 * (1 + 2**-stops) if stops < 0 else 0.009
    torch.testing.assert_close(linear(found)[:, ~clips], RADIANCE[:, ~clips], atol=tolerance, rtol=0)


def test_exposure_stops_are_applied_when_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "wall.png"
    pixels = encode_srgb(RADIANCE / 2).permute(1, 2, 0).contiguous().numpy()
    image = oiio.ImageBuf(pixels)
    assert image.write(str(path))
    photos = [read_task(path, 32, stops=stops).data["photo"] for stops in (0.0, -1.0)]
    assert torch.equal(photos[1], correct_exposure(photos[0], -1.0))
    assert float(linear(photos[1]).mean() / linear(photos[0]).mean()) == pytest.approx(2, rel=0.01)
