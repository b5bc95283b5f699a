"""Colours of image files: whatever space a file states, a picture looks as it is meant to."""

import os
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from data_tools.readers.colours import states_primaries
from data_tools.readers.environment_maps import read_map
from data_tools.readers.square_photos import read_photo
from metapp.appearance.colorimetry import import_colour_science
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from tests.pictures import add_png_chunks, channels_first, icc_profile, write_image

SIDE = 48
SPACES = {  # and a power of their encoding
    "P3": ("Display P3", 2.2),
    "Adobe RGB": ("Adobe RGB (1998)", 2.2),
    "Rec.2020": ("ITU-R BT.2020", 2.4),
    "ProPhoto": ("ROMM RGB", 1.8),
    "linear": ("ITU-R BT.709", 1.0),
    "linear Rec.2020": ("ITU-R BT.2020", 1.0),
}
ENDS = {"uint8": 255, "uint16": 65535, "float32": 1}


def picture(kind: str) -> np.ndarray:
    """Stored values [SIDE, SIDE, 3] of a smooth picture, most of whose colours Rec.709 has."""
    y, x = np.mgrid[:SIDE, :SIDE] / (SIDE - 1)
    values = 0.1 + 0.8 * np.stack([0.3 * x + 0.7 * y, 0.8 * y + 0.2 * x, (1 - x) * (0.3 + 0.7 * y)], -1)
    return (values * ENDS[kind]).round(0 if kind != "float32" else 6).astype(kind)


def space_of(name: str) -> Any:
    return import_colour_science().RGB_COLOURSPACES[SPACES[name][0]]


def light_of(name: str, values: np.ndarray) -> np.ndarray:
    """Stored colours of a space as linear Rec.709."""
    colour = import_colour_science()
    matrix = colour.matrix_RGB_to_RGB(space_of(name), colour.RGB_COLOURSPACES["ITU-R BT.709"], "Bradford")
    return (values / ENDS[values.dtype.name]) ** SPACES[name][1] @ matrix.T


def levels_off(path: Path, light: np.ndarray) -> torch.Tensor:
    """Return by how many levels of 255 a photograph differs from linear colours."""
    return (read_photo(path, SIDE) - linear_to_srgb(channels_first(light).clamp(0, 1)) * 255).abs()


def icc(name: str, description: str = "any name") -> bytes:
    """The ICC profile of a space."""
    colour, space = import_colour_science(), space_of(name)
    white, d50 = colour.xy_to_XYZ(space.whitepoint), np.array([0.9642, 1, 0.8249])
    adapted = colour.adaptation.matrix_chromatic_adaptation_VonKries(white, d50, "Bradford")
    return icc_profile(adapted @ space.matrix_RGB_to_XYZ, SPACES[name][1], description)


@pytest.mark.parametrize("name", SPACES)
@pytest.mark.parametrize("kind", ENDS)
def test_profiles_are_heeded_whatever_their_name(tmp_path: Path, name: str, kind: str) -> None:
    values = picture(kind)
    path = write_image(tmp_path / "a.tif", values, ICCProfile=icc(name))
    assert levels_off(path, light_of(name, values)).mean() < 0.4
    assert levels_off(path, light_of(name, values)).max() < (
        3.5 if name == "ProPhoto" else 1.6
    )  # where it leaves Rec.709
    if kind == "uint8":
        Image.fromarray(values).save(tmp_path / "a.webp", icc_profile=icc(name), lossless=True)
        assert levels_off(tmp_path / "a.webp", light_of(name, values)).max() < 1.6


def test_gray_profiles_are_heeded(tmp_path: Path) -> None:
    values = picture("uint8")[..., :1]
    write_image(tmp_path / "a.png", values, ICCProfile=icc_profile(np.eye(3), 1.5, kind=b"GRAY"))
    assert levels_off(tmp_path / "a.png", np.repeat((values / 255) ** 1.5, 3, -1)).max() < 1.1


def test_a_linear_profile_keeps_the_radiance_of_a_map(tmp_path: Path) -> None:
    light = np.random.default_rng(0).uniform(0.1, 90, (32, 64, 3)).astype(np.float32)
    wide = write_image(tmp_path / "a.tif", light, ICCProfile=icc("linear Rec.2020"))
    same = write_image(tmp_path / "a.exr", light_of("linear Rec.2020", light).astype(np.float32).clip(0))
    assert torch.allclose(read_map(wide), read_map(same), rtol=2e-3, atol=0.05)
    with pytest.raises(ValueError, match=r"b\.tif: colours in 'my own', expected a linear space"):
        read_map(write_image(tmp_path / "b.tif", light, ICCProfile=icc("P3", "my own")))


@pytest.mark.parametrize(("kind", "said"), [(b"CMYK", "'any ink'"), (b"", "'damaged'")])
def test_profiles_that_cannot_be_converted_cause_a_warning(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: bytes, said: str
) -> None:
    values = picture("uint8")
    stated = icc_profile(np.eye(3), 2.2, "any ink", kind) if kind else b"no profile at all, only text" * 9
    Image.fromarray(values).save(tmp_path / "a.png", icc_profile=stated)
    with pytest.warns(
        UserWarning, match=rf"a\.png: colours by the profile {said}, which cannot be converted, are taken"
    ):
        assert torch.equal(read_photo(tmp_path / "a.png", SIDE), channels_first(values))
    with warnings.catch_warnings(action="always"):
        warnings.showwarning = lambda message, *_, **__: os.write(2, str(message).encode())
        read_photo(tmp_path / "a.png", SIDE)
    assert "which cannot be converted" in capfd.readouterr().err  # though libraries are silent


def test_png_and_exif_state_colours_without_a_profile(tmp_path: Path) -> None:
    values, path = picture("uint8"), tmp_path / "a.png"
    Image.fromarray(values).save(path)
    plain = path.read_bytes()
    for name, (_, power) in SPACES.items():
        xy = [*space_of(name).whitepoint, *space_of(name).primaries.ravel()]
        numbers = struct.pack(">8I", *(round(1e5 * coordinate) for coordinate in xy))
        path.write_bytes(add_png_chunks(plain, {b"gAMA": struct.pack(">I", round(1e5 / power)), b"cHRM": numbers}))
        assert levels_off(path, light_of(name, values)).max() < 1, name
        path.write_bytes(add_png_chunks(plain, {b"sRGB": b"\0", b"cHRM": numbers}))
        assert torch.equal(read_photo(path, SIDE), channels_first(values))
    path.write_bytes(add_png_chunks(plain, {b"gAMA": struct.pack(">I", 100000)}))
    assert levels_off(path, values / 255).max() < 1
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    Image.fromarray(values).save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=exif)
    assert levels_off(tmp_path / "a.jpg", light_of("Adobe RGB", values)).mean() < 1


ROUND = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06)  # primaries of Rec.709
NOTHING_STATED = {
    "zeros": (0.0,) * 8,
    "equal": (0.3127, 0.329) * 4,
    "on a line": (0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.3127, 0.329),
    "white outside": (*ROUND, 0.9, 0.1),
    "no white": (*ROUND, 0.0, 0.0),
    "not finite": (float("nan"),) * 8,
}


@pytest.mark.parametrize("kind", NOTHING_STATED)
def test_primaries_that_cannot_be_state_nothing(tmp_path: Path, kind: str, recwarn: pytest.WarningsRecorder) -> None:
    xy = NOTHING_STATED[kind]
    assert not states_primaries(xy)
    values = picture("float32")
    assert levels_off(write_image(tmp_path / "a.exr", values, chromaticities=xy), values).max() < 1
    path = write_image(tmp_path / "a.hdr", values)
    rows = path.read_bytes()
    for text in (" ".join(f"{number:g}" for number in xy), "unknown", "0.64 0.33"):
        path.write_bytes(rows.replace(b"\n", f"\nPRIMARIES={text}\n".encode(), 1))
        assert levels_off(path, values).mean() < 1
    levels, path = picture("uint8"), tmp_path / "a.png"
    Image.fromarray(levels).save(path)
    whole = [round(1e5 * number) if np.isfinite(number) else 0 for number in (*xy[6:], *xy[:6])]
    path.write_bytes(add_png_chunks(path.read_bytes(), {b"cHRM": struct.pack(">8I", *whole)}))
    assert torch.equal(read_photo(path, SIDE), channels_first(levels))
    assert not [warning for warning in recwarn if issubclass(warning.category, UserWarning)]


@pytest.mark.parametrize("name", SPACES)
def test_primaries_of_known_spaces_are_stated(name: str) -> None:
    space = space_of(name)
    assert states_primaries((*space.primaries.ravel(), *space.whitepoint))


def test_code_points_of_png_are_heeded(tmp_path: Path) -> None:
    colour, values, path = import_colour_science(), picture("uint8"), tmp_path / "a.png"
    Image.fromarray(values).save(path)
    plain = path.read_bytes()
    encoded = {
        "P3": srgb_to_linear(torch.from_numpy(values / 255)).numpy(),
        "Rec.2020": colour.models.eotf_ST2084(values / 255) / 203,
    }
    for name, codes in {"P3": (12, 13, 0, 1), "Rec.2020": (9, 16, 0, 1)}.items():
        path.write_bytes(add_png_chunks(plain, {b"cICP": bytes(codes)}))
        matrix = colour.matrix_RGB_to_RGB(space_of(name), colour.RGB_COLOURSPACES["ITU-R BT.709"], "Bradford")
        assert levels_off(path, encoded[name] @ matrix.T).max() < 1.5, name
    path.write_bytes(add_png_chunks(plain, {b"cICP": bytes((11, 18, 0, 1))}))
    with pytest.warns(UserWarning, match=r"a\.png: colours of primaries 11 and transfer 18 .*cannot be conv"):
        read_photo(path, SIDE)


@pytest.mark.parametrize(("code", "name"), [(1, "ITU-R BT.709"), (9, "Rec.2020"), (12, "P3")])
@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_hybrid_log_gamma_is_light_whose_white_is_three_quarters(
    tmp_path: Path, code: int, name: str, kind: str
) -> None:
    colour, values, path = import_colour_science(), picture(kind), tmp_path / "a.png"
    write_image(path, values)
    path.write_bytes(add_png_chunks(path.read_bytes(), {b"cICP": bytes((code, 18, 0, 1))}))
    decode, rec709 = colour.models.oetf_inverse_BT2100_HLG, colour.RGB_COLOURSPACES["ITU-R BT.709"]
    light = decode(values / np.iinfo(values.dtype).max) / decode(0.75)
    matrix = np.eye(3) if code == 1 else colour.matrix_RGB_to_RGB(space_of(name), rec709, "Bradford")
    with pytest.warns(UserWarning, match=r"a\.png: HLG, whose signal of 75% is taken for white; "):
        assert levels_off(path, light @ matrix.T).max() < 1.5


def test_primaries_of_floating_point_files_are_heeded(tmp_path: Path) -> None:
    values = picture("float32")
    space = space_of("linear Rec.2020")
    xy = (*space.primaries.ravel(), *space.whitepoint)
    light = light_of("linear Rec.2020", values)
    assert levels_off(write_image(tmp_path / "a.exr", values, chromaticities=tuple(xy)), light).max() < 1
    path = write_image(tmp_path / "a.hdr", values)
    head = " ".join(f"{coordinate:.4f}" for coordinate in xy)
    rows = path.read_bytes()
    path.write_bytes(rows.replace(b"\n", f"\nPRIMARIES= {head}\n".encode(), 1))
    assert levels_off(path, light).mean() < 1
    for more, scale in {"EXPOSURE=4.0\nEXPOSURE= 0.5": 2, "EXPOSURE=2\nCOLORCORR=0.5 1 2": np.array([1, 2, 4])}.items():
        path.write_bytes(rows.replace(b"\n", f"\n{more}\n".encode(), 1))
        assert levels_off(path, values / scale).mean() < 1
    path.write_bytes(rows.replace(b"\n", b"\nEXPOSURE=0\n", 1))
    with pytest.raises(ValueError, match=r"a\.hdr: .*expected positive numbers"):
        read_photo(path, SIDE)
    path.write_bytes(rows.replace(b"32-bit_rle_rgbe", b"32-bit_rle_xyze"))
    with pytest.raises(ValueError, match=r"a\.hdr: colours in XYZ, expected RGB; convert it, such as by .*ra_xyze"):
        read_photo(path, SIDE)
