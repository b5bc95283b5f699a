"""Outputs of runs: files that are written for users, and records that later commands read.

In order of reading: `contact_sheet` draws fits beside their references, `fit_files` writes pictures, renderings and
exports of one fit, `run_records` reads what earlier runs wrote.
"""
