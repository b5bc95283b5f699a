"""OpenCV, which the extra `capture` of the package installs."""

from __future__ import annotations

from types import ModuleType


def opencv() -> ModuleType:
    """The module cv2.

    Raises:
        ValueError: it is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise ValueError('OpenCV: not installed, expected here; install it: pip install "metapp[capture]".') from None
    return cv2
