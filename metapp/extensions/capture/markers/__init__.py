"""A printed sheet of markers round a square opening: what it looks like, and photographs of it rectified.

Markers are ArUco's (Garrido-Jurado et al. 2014), which OpenCV draws and finds: `pip install "metapp[markers]"`.
"""

from __future__ import annotations

from types import ModuleType

INSTALL = 'pip install "metapp[markers]"'


def opencv() -> ModuleType:
    """The module cv2.

    Raises:
        ValueError: it is not installed, or too old for markers.
    """
    try:
        import cv2
        import cv2.aruco
    except ImportError:
        raise ValueError(f"OpenCV: not installed, expected for marker sheets; install it: {INSTALL}.") from None
    if not hasattr(cv2.aruco, "ArucoDetector"):
        raise ValueError(f"OpenCV: version {cv2.__version__}, expected 4.10 or later; install it: {INSTALL}.")
    return cv2
