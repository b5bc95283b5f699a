"""Models of ONNX: traced by torch, with a description in their metadata."""

from __future__ import annotations

import importlib.util
import logging
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

ONNX_OPSET = 18
MIN_16_BIT_WEIGHT_NUMBERS, MIN_8_BIT_WEIGHT_NUMBERS = (
    1024,
    1 << 21,
)  # numbers of a weight that is stored in 16 bits, and in 8
MISSING_PACKAGES_MESSAGE = 'needs onnx and onnxscript: pip install "metapp[export]"'


def require_packages() -> None:
    """Refuse to go on without the packages.

    Raises:
        ValueError: they are not installed.
    """
    if not all(map(importlib.util.find_spec, ("onnx", "onnxscript"))):
        raise ValueError(f"ONNX {MISSING_PACKAGES_MESSAGE}.")


def encode_model(
    module: torch.nn.Module,
    inputs: Mapping[str, Tensor],
    outputs: Sequence[str],
    sizes: Mapping[str, Mapping[int, Any]],
    about: Mapping[str, str],
    *,
    half: bool = False,
    largest: int = MIN_8_BIT_WEIGHT_NUMBERS,
) -> bytes:
    """A module as a model, the content of its file.

    Args:
        module: its parameters are the weights; takes the inputs in order and gives the outputs.
        inputs: examples, by name.
        outputs: names.
        sizes: of each input the axes of any size, as of torch.export.
        about: kept as metadata.
        half: store large weights in half precision, the largest in 8 bits.
        largest: numbers of a weight from which on it is one of the largest.

    Raises:
        ValueError: packages are missing.
    """
    require_packages()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        for name in ("torch.onnx", "onnxscript"):
            logging.getLogger(name).setLevel(logging.ERROR)
        program = torch.onnx.export(
            module.eval(),
            tuple(inputs.values()),
            dynamo=True,
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_shapes=dict(sizes) or None,
            opset_version=ONNX_OPSET,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    for node in model.graph.node:
        del node.metadata_props[:]  # where in the source it comes from
    if half:
        _halve(model.graph, largest)
    del model.metadata_props[:]
    for key, text in about.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, text
    content: bytes = model.SerializeToString()
    return content


def _halve(graph: Any, largest: int) -> None:
    """Store large weights in 16 bits, the largest in 8 with a scale for each output, of which runtimes make 32."""
    from onnx import TensorProto, helper, numpy_helper

    nodes, scales = [], []
    for weight in graph.initializer:
        numbers = np.prod(weight.dims)
        if weight.data_type != TensorProto.FLOAT or numbers < MIN_16_BIT_WEIGHT_NUMBERS:
            continue
        name, values = weight.name, numpy_helper.to_array(weight)
        if numbers < largest:
            weight.CopyFrom(numpy_helper.from_array(values.astype(np.float16), f"{name}.half"))
            nodes.append(helper.make_node("Cast", [f"{name}.half"], [name], to=TensorProto.FLOAT))
            continue
        scale = np.maximum(np.abs(values).reshape(len(values), -1).max(1), 1e-12) / 127
        rounded = np.round(values / scale.reshape(-1, *[1] * (values.ndim - 1))).astype(np.int8)
        weight.CopyFrom(numpy_helper.from_array(rounded, f"{name}.int8"))
        scales.append(numpy_helper.from_array(scale.astype(np.float32), f"{name}.scale"))
        nodes.append(helper.make_node("DequantizeLinear", [f"{name}.int8", f"{name}.scale"], [name], axis=0))
    graph.initializer.extend(scales)
    nodes += graph.node
    del graph.node[:]
    graph.node.extend(nodes)
