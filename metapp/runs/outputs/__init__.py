"""Outputs of runs: files, pictures, records."""
