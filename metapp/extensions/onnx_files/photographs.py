"""General of flash photographs as an ONNX model: it makes the maps of a material from one photograph.

The model holds all of the application that General needs: the decoding of sRGB, the encoder and the decoder. Programs
that run it need to know neither this package nor torch.
"""

from __future__ import annotations

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.colour import srgb_to_linear
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps
from metapp.extensions.onnx_files.models import encode_model
from metapp.learning.task import Params

MODEL_OUTPUTS = ("diffuse", "specular", "roughness", "normal")
MODEL_SIDE_STEP_PX = 8  # of models that take photos of any size; sides are multiples of it
PHOTO_MODEL_DESCRIPTION = {
    "photo": "sRGB values 0 to 1, [1, 3, H, W], of a flat patch under the flash beside the lens",
    "diffuse": "linear RGB, [1, 3, H, W]",
    "specular": "F0, linear RGB, [1, 3, H, W]",
    "roughness": "GGX, alpha is its square, [1, 1, H, W]",
    "normal": "unit vectors, x to the right, y up, z to the viewer, [1, 3, H, W]",
}
VGG_CREDIT = "VGG-16 of Simonyan and Zisserman 2014, weights of the Visual Geometry Group under CC BY 4.0"


def decoder_of(app: SvbrdfNonstationary) -> FieldMaps:
    """Return the decoder of an application whose maps a field makes.

    Raises:
        ValueError: the parameters of its fits are maps of texels.
    """
    if not isinstance(app.decoder, FieldMaps):
        raise ValueError(
            "General of several photos, expected General of one photo; export the maps of its fits instead."
        )
    return app.decoder


class MaterialModule(torch.nn.Module):
    """General as a module to trace: MODEL_OUTPUTS, the maps of a material, from a photograph [1, 3, H, W].

    Args:
        app: the application, with the size of its network.
        encoder: the parameters of General's encoder.
    """

    def __init__(self, app: SvbrdfNonstationary, encoder: Params) -> None:
        super().__init__()
        self.app, self.decoder = app, decoder_of(app)
        self.names = {name.replace(".", "-"): name for name in encoder}
        weights = {key: encoder[name].float() for key, name in self.names.items()}
        self.encoder = torch.nn.ParameterDict(weights)

    @override
    def forward(self, photo: Tensor) -> tuple[Tensor, ...]:
        linear = srgb_to_linear(photo)
        seen = self.app.sight.seen_type(linear, linear.new_zeros(1, 1))
        encoder = {name: self.encoder[key] for key, name in self.names.items()}
        decoder = self.decoder
        theta = self.app.encode(encoder, self.app.encoder.select_input(seen))
        maps = decoder.finish_maps(decoder.evaluate(theta, seen.inputs))
        return tuple(getattr(maps, name) for name in MODEL_OUTPUTS)

    def reads_any_size(self) -> bool:
        """Return whether the module reads photographs of other sizes than the network's own."""
        with torch.no_grad():
            try:
                return bool(
                    self(torch.rand(1, 3, 2 * MODEL_SIDE_STEP_PX, 3 * MODEL_SIDE_STEP_PX))[0].shape[-1]
                    == 3 * MODEL_SIDE_STEP_PX
                )
            except RuntimeError:
                return False


def encode_photo_model(app: SvbrdfNonstationary, encoder: Params, about: dict[str, str]) -> tuple[bytes, bool]:
    """Trace General of flash photographs as an ONNX model.

    Args:
        app: the application.
        encoder: the parameters of General's encoder.
        about: texts for the metadata, beside the description of inputs and outputs.

    Returns:
        The content of the file, and whether the model takes photographs of any size whose sides are multiples of
        MODEL_SIDE_STEP_PX; else it takes photographs of the network's size alone.

    Raises:
        ValueError: onnx or onnxscript is not installed.
    """
    model, side = MaterialModule(app, encoder), decoder_of(app).network.height
    any_size = model.reads_any_size()
    # the example has two different sides, so that the trace does not take height and width for one number
    shape = (side, side - 8 * MODEL_SIDE_STEP_PX) if any_size else (side, side)
    largest = 4096 // MODEL_SIDE_STEP_PX
    axes = {2 + i: MODEL_SIDE_STEP_PX * torch.export.Dim(name, min=2, max=largest) for i, name in enumerate(("h", "w"))}
    sizes = {"photo": axes} if any_size else {}
    return encode_model(
        model, {"photo": torch.rand(1, 3, *shape)}, MODEL_OUTPUTS, sizes, about | PHOTO_MODEL_DESCRIPTION, half=True
    ), any_size
