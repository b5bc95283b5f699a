"""Fitted BRDFs, and General of flash photographs, as ONNX models.

Read `models`, how a module becomes a model; `brdf_model` and `photographs`, the two modules; then `general_files`, the
export of a checkpoint.
"""
