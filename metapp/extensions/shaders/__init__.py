"""Fitted BRDFs as source code of shaders: one file without data beside it, with eval, sample and pdf."""
