"""Fitted BRDFs, and General of flash photographs, as ONNX models."""
