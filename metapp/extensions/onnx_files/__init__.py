"""Fitted BRDFs, and General of flash photographs, as ONNX models."""

from __future__ import annotations

from metapp.registry import Entry, Export, Registry

_HERE = "metapp.extensions.onnx_files"


def register(registry: Registry) -> None:
    """Add the exports."""
    registry.exports["brdf", "onnx"] = Export(f"{_HERE}.brdf:write_onnx", needs=("onnxscript", "onnx and onnxscript"))
    for kind in ("onnx", "onnx-page"):
        registry.file_exports[kind] = Entry(
            f"{_HERE}.checkpoints:write", help="General of photos, by a checkpoint or its name"
        )
