"""HEIF pictures of phones: upright whatever their orientation, and one line where they cannot be read."""

from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers import flash_photos, image_files, opened_images
from data_tools.readers.square_photos import find, read_photo
from metapp.appearance.colour import linear_to_srgb
from tests.pictures import P3_TO_SRGB, STORED_BY_ORIENTATION, channels_first, icc_profile

pillow_heif = pytest.importorskip("pillow_heif", reason='pillow-heif is not installed: pip install "metapp[heic]"')
from PIL import Image  # noqa: E402

P3_TO_XYZ = np.array([[0.5151, 0.2920, 0.1571], [0.2412, 0.6922, 0.0666], [-0.0011, 0.0419, 0.7841]])  # of D50


def gradients(height: int = 96, width: int = 48) -> np.ndarray:
    """A picture whose corners all differ, smooth, so that compression costs little."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    return np.uint8(np.stack([40 + 180 * x, 30 + 200 * y, 60 + 90 * (x + y)], -1))


def write(path: Path, values: np.ndarray, orientation: int = 1, focal: int = 0, icc: bytes | None = None) -> Path:
    pillow_heif.register_heif_opener()
    image = Image.fromarray(values)
    exif = image.getexif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769)[0xA405] = focal
    image.save(path, format="HEIF", exif=exif.tobytes(), quality=100, chroma=444, icc_profile=icc)
    return path


@pytest.mark.parametrize("orientation", range(1, 9))
def test_heif_pictures_are_upright(tmp_path: Path, orientation: int) -> None:
    upright = gradients()
    path = write(tmp_path / "a.heic", np.ascontiguousarray(STORED_BY_ORIENTATION[orientation](upright)), orientation)
    found = read_photo(path, 48).float()
    assert (found - channels_first(upright[24:72])).abs().mean() < 2


def test_a_display_p3_profile_is_heeded(tmp_path: Path) -> None:
    values = gradients(64, 64)
    plain = read_photo(write(tmp_path / "a.heic", values), 64).double() / 255
    wide = read_photo(write(tmp_path / "b.heic", values, icc=icc_profile(P3_TO_XYZ, 2.2)), 64).double() / 255
    expected = linear_to_srgb(torch.einsum("ij,jhw->ihw", P3_TO_SRGB, plain**2.2).clamp(0, 1))
    assert (wide - expected).abs().max() < 2 / 255
    assert (wide - plain).abs().max() > 3 / 255


def test_damaged_or_small_pictures_are_refused_in_one_line(tmp_path: Path) -> None:
    path = write(tmp_path / "a.heic", gradients())
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(ValueError, match=r"a\.heic: .*expected a whole one; copy or download it again\.$") as error:
        read_photo(path)
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="20x20 px, expected 32 px or more"):
        read_photo(write(tmp_path / "a.heic", gradients(20, 20)))


def test_without_the_library_the_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.heic", gradients())
    for module in (image_files, opened_images):
        monkeypatch.setattr(module, "can_read_heif", lambda: False)
    with pytest.raises(
        ValueError, match=r'export it as JPEG or PNG, or read it as it is: pip install "metapp\[heic\]"'
    ):
        read_photo(path)
    with pytest.raises(ValueError, match="a picture in HEIF or AVIF"):
        find(tmp_path)


def test_lens_data_is_read_from_heif_files(tmp_path: Path) -> None:
    values = gradients(120, 120)
    path = write(tmp_path / "a.heic", values, focal=20)  # 75 degrees along a square's side
    share = np.tan(np.radians(22.5)) / (15.2967 / 20)  # half of 43.2666 / sqrt(2) mm
    side = round(120 * share)
    cropped = channels_first(values[(120 - side) // 2 :, (120 - side) // 2 :][:side, :side])
    found = flash_photos.read_task(path, side).data["image"].float()
    assert (found - cropped).abs().mean() < 2
