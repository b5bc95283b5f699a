"""Arrays, tensors and pictures of every kind as inputs of `metapp.fit`: a finite fit, or one line that names them."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

from torture.child import BadResult
from torture.seeds import Files

CASE = "case"
TYPES = ("f2", "f4", "f8", ">f4", ">f2", "g", "u1", "i1", "u2", ">u2", "i4", "u8", "?", "c8", "O", "S3", "M8[s]")
VALUES = (float("nan"), float("inf"), float("-inf"), -1.0, -1e-9, 1e-40, 1.0001, 2.0, 1e5, 1e30, 3e38)
SHAPES = ((), (0,), (3,), (5, 3), (0, 0, 3), (1, 1, 3), (1, 64, 3), (2, 4, 3), (31, 33, 3), (32, 64), (32, 64, 1),
          (32, 64, 2), (32, 64, 4), (3, 32, 64), (1, 32, 64, 3), (32, 64, 3, 1), (300, 20, 3))  # fmt: skip
MODES = (
    "1",
    "L",
    "P",
    "LA",
    "PA",
    "La",
    "RGB",
    "RGBA",
    "RGBa",
    "RGBX",
    "CMYK",
    "YCbCr",
    "LAB",
    "HSV",
    "I",
    "I;16",
    "F",
)
STEPS = 2


def cases() -> list[Files]:
    """None, as all are drawn; what a first fit loads is loaded now."""
    import metapp

    metapp.fit("brdf", lambda wi, wo: abs(wi), device="cpu")
    return []


def write(rng: random.Random, folder: Path) -> Path:
    """The seed of a case."""
    (folder / CASE).write_text(str(rng.randrange(2**32)))
    return folder / CASE


def read(folder: Path, file: Path) -> None:
    """As a program does."""
    import metapp

    app, source, options = draw(random.Random(file.read_text()))
    try:
        fit = metapp.fit(app, source, recipe="quick", steps=STEPS, device="cpu", **options)
    except ValueError as error:
        if not str(error).startswith(("object", "strange")):
            raise BadResult(f"{app}: the message does not begin with the name: {error}") from None
        raise type(error)(f"{folder}: {error}") from None
    if not all(bool(value.isfinite().all()) for value in fit.parameters.values()):
        raise BadResult(f"{app}: parameters that are not finite")
    if fit.error is not None and not 0 <= fit.error < float("inf"):
        raise BadResult(f"{app}: an error of {fit.error}")


def draw(rng: random.Random) -> tuple[str, Any, dict[str, str]]:
    """An application, something strange in memory, and options."""
    app = rng.choice(("brdf", "brdf", "texture", "svbrdf_stationary", "svbrdf_nonstationary", "illumination"))
    options = {"paradigm": rng.choice(("meta", "overfit"))}
    if app == "brdf":
        return app, _samples(rng), {}
    if app == "svbrdf_nonstationary" and rng.random() < 0.5:
        names = ("diffuse", "normal", "roughness", "specular", "height", "", "Normal map")
        shape = rng.choice(SHAPES[8:])
        chosen = [*names[:4], *rng.sample(names, 1)][rng.choice((0, 0, 0, 1)) :]
        return app, {name: strange(rng, _numbers(rng, shape, name)) for name in chosen}, options
    if app == "svbrdf_nonstationary" or (app == "illumination" and rng.random() < 0.5):
        options["observe"] = "photo"
    picture = strange(rng, _numbers(rng, rng.choice((*SHAPES, *SHAPES[-2:] * 2, *[(32, 64, 3)] * 30))))
    return app, _function(picture) if rng.random() < 0.1 else picture, options


def _function(result: Any) -> Any:
    def strange_function(*_: Any) -> Any:
        return result

    return strange_function


def _samples(rng: random.Random) -> Any:
    """Measured samples, or a function of directions."""
    import numpy as np

    numbers, count = (
        np.random.default_rng(rng.randrange(2**32)),
        rng.choice((0, 1, 3, 4, 5, 6, 7, 8, 30, 30, 30, 300, 1001, 3000)),
    )
    if rng.random() < 0.1:
        return _function(strange(rng, _numbers(rng, rng.choice(SHAPES))))
    directions = numbers.standard_normal((2, count, 3)) * rng.choice((1, 1, 1, (0, 1, 1), (0, 0, 1), (1e-5, 0, 1)))
    directions[..., 2] = abs(directions[..., 2]) * rng.choice((1, 1, 1, 1, -1, 1e-9))
    with np.errstate(invalid="ignore"):
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    if rng.random() < 0.3 and count:
        directions[:] = directions[:, :1]
    arrays: list[Any] = [*directions, _numbers(rng, (count, 3))]
    at = rng.randrange(3)
    arrays[at] = strange(rng, arrays[at])
    return tuple(arrays[: rng.choice((3,) * 15 + (2,))])


def _numbers(rng: random.Random, shape: tuple[int, ...], role: str = "") -> Any:
    """Values of some range, float64; of normals mostly unit vectors."""
    import numpy as np

    values = np.random.default_rng(rng.randrange(2**32)).random(shape) * rng.choice((1, 1, 1, 0.5, 1e-3, 0, 255, 1e-30))
    if role.lower().startswith("normal") and shape[-1:] == (3,) and rng.random() < 0.9:
        values = np.full(shape, (0.0, 0.0, 1.0))
    return np.full_like(values, 0.5) if rng.random() < 0.1 else values


def strange(rng: random.Random, values: Any) -> Any:
    """The same in another type, order or library, with a few values that are odd."""
    import numpy as np

    if rng.random() < 0.2 and values.size:
        values.flat[[rng.randrange(values.size) for _ in range(rng.choice((1, 3)))]] = rng.choice(VALUES)
    if rng.random() < 0.5:
        kind = rng.choice((*TYPES, *TYPES[:5], *TYPES[:5], "u1", "u2", ">u2"))
        with np.errstate(all="ignore"):
            most = 255 if np.dtype(kind).kind in "ui" and values.size and values.max() <= 1 else 1
            values = np.asarray(values * most).astype(kind)
    if rng.random() < 0.3:
        values = rng.choice((
            lambda: np.flip(values), lambda: np.repeat(values, 2, 0)[::2] if values.ndim else values,
            lambda: np.asfortranarray(values), lambda: values.T, lambda: np.ascontiguousarray(values.T).T,
            lambda: np.broadcast_to(values[:1], values.shape) if values.ndim else values,
            lambda: np.ma.masked_array(values, rng.choice((False, True))), lambda: values.view(np.ndarray).tolist(),
            lambda: np.broadcast_to(values[..., :1], (*values.shape[:-1], 10**9)) if values.size and values.ndim
            else values,
            lambda: np.broadcast_to(np.float32(0.5), (60000, 60000, 3)),
        ))()  # fmt: skip
        values = values.view() if isinstance(values, np.ndarray) else values
    if isinstance(values, np.ndarray) and rng.random() < 0.2:
        values.flags.writeable = False
    if isinstance(values, np.ndarray) and values.size < 10**6:
        if rng.random() < 0.3 and values.dtype.kind in "fiub" and values.dtype.char != "g":
            return _tensor(rng, values)
        if rng.random() < 0.15 and values.ndim == 3:
            return _picture(rng, values.shape[1::-1])
    return values


def _tensor(rng: random.Random, values: Any) -> Any:
    """A tensor of any kind, layout or place."""
    import numpy as np
    import torch

    tensor = torch.from_numpy(np.array(values, values.dtype.newbyteorder("=")))
    return rng.choice((
        lambda: tensor, tensor.half, tensor.bfloat16, lambda: tensor.float().requires_grad_(),
        lambda: tensor.to(torch.float8_e5m2), lambda: tensor.float().to_sparse(), lambda: tensor.to("meta"),
        lambda: tensor.float().transpose(0, -1),
        lambda: torch.quantize_per_tensor(tensor.float(), 1 / 255, 0, torch.quint8), lambda: tensor[None],
        lambda: torch.complex(tensor.float(), tensor.float()).conj().imag, lambda: tensor.expand(10**6, *tensor.shape),
        lambda: torch.nested.nested_tensor([tensor.float()]), lambda: torch.nn.Parameter(tensor.float()),
    ))()  # fmt: skip


def _picture(rng: random.Random, size: tuple[int, int]) -> Any:
    """A picture of PIL of any mode, of noise or black."""
    from PIL import Image

    mode = rng.choice(MODES)
    try:
        return Image.effect_noise(size, 60).convert("RGB").convert(mode)
    except ValueError:  # PIL converts to some modes alone
        return Image.new(mode, size)
