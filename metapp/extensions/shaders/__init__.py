"""Fitted BRDFs as source code of shaders: one file without data beside it, with eval, sample and pdf.

Read `hlsl_source`, the code of a BRDF in HLSL; `languages`, its translation; then `shader_files`, the exports.
"""
