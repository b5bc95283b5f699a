"""Fitted BRDFs, and General of flash photographs, as ONNX models."""

from __future__ import annotations

from metapp.door import Export, FileExport

_HERE = "metapp.extensions.onnx_files"
OFFERS = (
    Export("onnx", ("brdf",), f"{_HERE}.brdf:write_onnx", needs=("onnxscript", "onnx and onnxscript")),
    FileExport(("onnx", "onnx-page"), "General of photos, by a checkpoint or its name", f"{_HERE}.checkpoints:write"),
)
