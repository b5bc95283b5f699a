"""Fitted BRDFs, and General of flash photographs, as ONNX models."""

from __future__ import annotations

from metapp.door import Command, Export

_HERE = "metapp.extensions.onnx_files"
OFFERS = (
    Export("onnx", ("brdf",), f"{_HERE}.brdf:write_onnx", needs=("onnxscript", "onnx and onnxscript")),
    Command("export-model", f"{_HERE}.commands:export_model"),
)
