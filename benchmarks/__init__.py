"""Measurements of time, memory and errors, none of which a test asserts; `python -m benchmarks.bench_learning`."""
