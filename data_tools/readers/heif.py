"""HEIF pictures (.heic), as phones write them, read by pillow-heif: `pip install "metapp[heic]"`.

libheif turns the picture as the file says and decodes it to 8 bits. AVIF, and files of other encoders, are left out.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pillow_heif import HeifFile

INSTALL = 'pip install "metapp[heic]"'
_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")  # ISO/IEC 23008-12
_MODES = ("RGB", "RGBA")


class Decoded(NamedTuple):
    """A picture.

    Attributes:
        values: uint8 [height, width, 3], or 4 with alpha last, upright.
        profile: the description of its ICC profile; "" for none.
    """

    values: NDArray[np.uint8]
    profile: str


def is_heif(path: Path) -> bool:
    """Whether a file begins as HEIF pictures do, whatever its name."""
    try:
        with path.open("rb") as stream:
            start = stream.read(12)
    except OSError:
        return False
    return start[4:8] == b"ftyp" and start[8:12] in _BRANDS


def can_read() -> bool:
    """Whether pillow-heif is installed."""
    return importlib.util.find_spec("pillow_heif") is not None


def open_heif(path: Path) -> HeifFile:
    """A picture whose size is known and whose pixels are not decoded yet.

    Raises:
        ValueError: it is damaged.
    """
    import pillow_heif

    try:
        source = pillow_heif.open_heif(path)
        assert source.size  # fails where there is no picture in it
        return source
    except Exception as error:  # whatever libheif says
        raise ValueError(_damaged(path, error)) from None


def decode(source: HeifFile, path: Path) -> Decoded:
    """The pixels of what `open_heif` returned.

    Raises:
        ValueError: it is damaged, or of another kind.
    """
    if source.mode not in _MODES:
        raise ValueError(f"{path}: a HEIF picture of mode {source.mode}, expected RGB; export it as JPEG or PNG.")
    try:
        values = np.asarray(source)
    except Exception as error:
        raise ValueError(_damaged(path, error)) from None
    return Decoded(values, _description(source.info.get("icc_profile")))


def _damaged(path: Path, error: Exception) -> str:
    reason = (str(error) or type(error).__name__).splitlines()[0][:80].replace(str(path), "").strip(" :.")
    return f"{path}: a HEIF picture that cannot be decoded ({reason}), expected a whole one; copy or download it again."


def _description(profile: bytes | None) -> str:
    """What an ICC profile calls itself; "" where it is damaged."""
    from PIL import ImageCms

    with contextlib.suppress(ImageCms.PyCMSError, OSError, TypeError):
        if profile:
            return str(ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))).strip()
    return ""
