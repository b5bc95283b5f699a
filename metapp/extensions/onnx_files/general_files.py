"""The export of a checkpoint: General of flash photographs as an ONNX model.

This is the part of `metapp export` that finds the checkpoint, names the files and says what was written.
"""

from __future__ import annotations

from pathlib import Path

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.extensions.onnx_files.models import ONNX_OPSET, require_packages
from metapp.extensions.onnx_files.photographs import (
    MODEL_SIDE_STEP_PX,
    VGG_CREDIT,
    decoder_of,
    encode_photo_model,
)
from metapp.runs.checkpoints import GENERAL, read_checkpoint
from metapp.runs.inputs.refusals import check_new_files
from metapp.runs.reporter import say
from metapp.runs.resolve import app_of, complete, recipe_of
from metapp.runs.spec import Spec
from metapp.storage.checkpoint_files import read_headers
from metapp.storage.files import write_bytes
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME

PHOTO_APP = "svbrdf_nonstationary"


def write_general(path: Path, kind: str, folder: Path, quiet: bool) -> list[Path]:
    """Write General of flash photographs as <folder>/<name>.onnx.

    Args:
        path: a checkpoint, or the name of one that ships: svbrdf_nonstationary, or with a recipe
            svbrdf_nonstationary/pretrained.
        kind: onnx, which the signature of exports asks for.
        folder: the folder that files are written into.
        quiet: whether to print no messages.

    Returns:
        The model.

    Raises:
        ValueError: there is no checkpoint of General of one photograph; onnx or onnxscript is missing.
        BadOption: the file exists already.
    """
    given = _spec_of_general(path)
    file = folder / f"{path.stem if path.is_file() else '-'.join(path.parts)}.onnx"
    check_new_files([file])
    require_packages()
    spec = complete(given)
    app = app_of(spec)
    encoder = read_checkpoint(spec, app, recipe_of(spec)).encoder
    assert isinstance(app, SvbrdfNonstationary)
    try:
        side = decoder_of(app).network.height
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    metadata = {"made_by": "metapp export", "recipe": spec.recipe, "checkpoint": spec.digest, "license": "MIT"}
    if app.recorded_conditions():
        metadata |= {"features": VGG_CREDIT, "license": f"MIT; of the features: {VGG_CREDIT}"}
    model, any_size = encode_photo_model(app, encoder, metadata)
    write_bytes(file, model)
    if not quiet:
        sizes = f"whose sides are multiples of {MODEL_SIDE_STEP_PX}" if any_size else f"of {side} x {side}"
        say(f"{file}: {len(model) / 1e6:.1f} MB of ONNX, opset {ONNX_OPSET}, takes photos {sizes} px")
    return [file]


def _spec_of_general(path: Path) -> Spec:
    """Return the specification of fits by General whose checkpoint is a file, or ships by a name.

    Raises:
        ValueError: neither a file, nor the name of a checkpoint that ships.
    """
    app, recipe = path.parts[:1], "".join(path.parts[1:2]) or FULL_RECIPE_NAME
    if is_file := path.is_file():
        headers = read_headers(path).values()
        recipes = [str(header.get("recipe")) for header in headers if header.get("checkpoint") == GENERAL]
        recipe = next(iter(recipes), FULL_RECIPE_NAME)
    elif app != (PHOTO_APP,) or len(path.parts) > 2:
        raise ValueError(
            f"{path}: no such file, expected a run, a checkpoint of General of photos, or the name of one that ships: "
            f"{PHOTO_APP} or {PHOTO_APP}/RECIPE."
        )
    checkpoint = path if is_file else None
    return Spec(app=PHOTO_APP, paradigm="general", recipe=recipe, observe="photo", checkpoint=checkpoint, device="cpu")
