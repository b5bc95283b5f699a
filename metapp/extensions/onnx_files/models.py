"""ONNX models: modules of torch, traced, with small weights and a description in their metadata.

This module turns any module into the content of a file. It does not know what the module computes, and it alone imports
onnx, which an extra of the package brings.
"""

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
# numbers of a weight from which on it is stored in 16 bits, and in 8 bits; smaller ones cost little in 32 bits
MIN_16_BIT_WEIGHT_NUMBERS, MIN_8_BIT_WEIGHT_NUMBERS = 1024, 1 << 21
MISSING_PACKAGES_MESSAGE = 'needs onnx and onnxscript: pip install "metapp[export]"'


def require_packages() -> None:
    """Refuse to go on without the packages onnx and onnxscript.

    Raises:
        ValueError: one of them is not installed.
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
    """Trace a module as an ONNX model.

    Args:
        module: the module, which takes the inputs in order and returns the outputs; its parameters become the weights.
        inputs: examples of the inputs, by name.
        outputs: names of the outputs.
        sizes: axes of any size of each input, `dynamic_shapes` of torch.export.
        about: texts that are kept as metadata, by name.
        half: whether to store large weights in half precision, and the largest in 8 bits.
        largest: numbers of a weight from which on it is stored in 8 bits.

    Returns:
        The content of the file.

    Raises:
        ValueError: onnx or onnxscript is not installed.
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
        del node.metadata_props[:]  # places in Python's source
    if half:
        _compress_weights(model.graph, largest)
    del model.metadata_props[:]
    for key, text in about.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, text
    content: bytes = model.SerializeToString()
    return content


def _compress_weights(graph: Any, largest: int) -> None:
    """Store large weights in 16 bits, and the largest in 8 bits with a scale for each output.

    Nodes are added that make weights of 32 bits of them when a runtime loads the model.

    Args:
        graph: the graph of the model, which is changed.
        largest: numbers of a weight from which on it is stored in 8 bits.
    """
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
