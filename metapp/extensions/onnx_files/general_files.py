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
from metapp.runs.checkpoint_selection import find_checkpoint
from metapp.runs.choice import choose
from metapp.runs.fit_options import FitOptions, check_new_files, fit_options
from metapp.runs.reporter import say
from metapp.storage.checkpoint_files import load_checkpoint
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
    options = _general_options(path)
    file = folder / f"{path.stem if path.is_file() else '-'.join(path.parts)}.onnx"
    check_new_files([file])
    require_packages()
    choice = choose(options)
    app, checkpoint = choice.app, find_checkpoint(choice)
    assert isinstance(app, SvbrdfNonstationary)
    try:
        side = decoder_of(app).network.height
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    metadata = {"made_by": "metapp export", "recipe": options.recipe, "checkpoint": checkpoint.digest, "license": "MIT"}
    if app.recorded_conditions():
        metadata |= {"features": VGG_CREDIT, "license": f"MIT; of the features: {VGG_CREDIT}"}
    model, any_size = encode_photo_model(app, checkpoint.phi.encoder, metadata)
    write_bytes(file, model)
    if not quiet:
        sizes = f"whose sides are multiples of {MODEL_SIDE_STEP_PX}" if any_size else f"of {side} x {side}"
        say(f"{file}: {len(model) / 1e6:.1f} MB of ONNX, opset {ONNX_OPSET}, takes photos {sizes} px")
    return [file]


def _general_options(path: Path) -> FitOptions:
    """Return the options of a fit by General whose checkpoint is a file, or ships by a name.

    Raises:
        ValueError: neither a file, nor the name of a checkpoint that ships.
    """
    app, recipe = path.parts[:1], "".join(path.parts[1:2]) or FULL_RECIPE_NAME
    if is_file := path.is_file():
        record = load_checkpoint(path)[1]
        recipe = str(record.get("recipe", FULL_RECIPE_NAME)) if record.get("app") == PHOTO_APP else FULL_RECIPE_NAME
    elif app != (PHOTO_APP,) or len(path.parts) > 2:
        raise ValueError(
            f"{path}: no such file, expected a run, a checkpoint of General of photos, or the name of one that ships: "
            f"{PHOTO_APP} or {PHOTO_APP}/RECIPE."
        )
    return fit_options(
        PHOTO_APP, "general", recipe=recipe, observe="photo", checkpoint=path if is_file else None, quiet=True
    )
