"""Faults of pictures and maps like a photograph's, in words; they show without a reference."""

from __future__ import annotations

from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.flash import GAMMA, Maps
from metapp.appearance.order import high_passed, lattice_of, order_kept

LEAST_ORDER = 0.5  # of the order; quilting keeps 0.68 to 1.0
# Of flat materials whose photos have fewer clipped px the highlight says at least 0.75 of F0, of those with more down
# to 0.34 (9 in 10 of 136 renderings, roughness 0.16 to 0.6, F0 up to 1).
CLIPPED_SHARE = 0.01
CELLS = 8  # along a side: blobs are of this size or larger, up to a quarter of a side
EVEN_CONTRAST = 0.02  # unevenness that is none: that of an even photo's sensor, and what steps leave in maps
# General's maps of 12 of 220 synthetic materials have more, 7 of them 2 to 10 times as much as the true maps; the other
# 5 are rust, whose roughness does vary so.
BLOB_CONTRAST = 1.1


def of_order(app: str, photo: Tensor, made: Tensor) -> list[str]:
    """Regular structure that was lost; nothing if the photo has none.

    Args:
        app: the application's name, for the command that copies it.
        photo: [3, H, W], evenly lit.
        made: its fit, [3, h, w] of the same scale.
    """
    kept = order_kept(lattice_of(photo), made)
    instead = f"`metapp baseline {app} INPUT --method quilting` copies it"
    return [f"keeps {kept:.2f} of the photo's regular structure ({instead})"] if kept < LEAST_ORDER else []


def of_highlight(photo: Tensor) -> list[str]:
    """A highlight that is clipped in a photo uint8 [3, H, W]."""
    share = float((photo == 255).all(0).float().mean())
    clipped = f"the photo is clipped in {100 * share:.2g} % of its px, so F0 is a lower bound"
    return [clipped] if share > CLIPPED_SHARE else []


def of_blobs(photo: Tensor, maps: Maps) -> list[str]:
    """Blobs in a map that the photo does not show.

    Args:
        photo: [3, H, W], evenly lit, display values.
        maps: of the same size, without leading axes.
    """
    display = {name: part.clamp(0, 1) ** (1 / GAMMA) for name, part in zip(maps._fields[:2], maps[:2], strict=True)}
    allowed = uneven(photo) + EVEN_CONTRAST
    times = {name: uneven(part) / allowed for name, part in (display | {"roughness": maps.roughness}).items()}
    worst = max(times, key=lambda name: times[name])
    blobs = f"blobs in {worst} that the photo does not show, {times[worst]:.1f} times its contrast"
    return [blobs] if times[worst] > BLOB_CONTRAST else []


def uneven(picture: Tensor) -> float:
    """By how much a cell of a picture [C, H, W], one of CELLS x CELLS, differs at most from its surroundings."""
    fine = high_passed(picture, min(picture.shape[-2:]) // 4 | 1)
    return float(adaptive_avg_pool2d(fine, CELLS).abs().max())
