"""MERL tables (Matusik et al. 2003)."""

from __future__ import annotations

from data_tools.formats import Format, Setting

HELP = """Convert MERL tables, measured BRDFs.

A table (Matusik et al. 2003) has 34,992,012 bytes. It becomes samples (angles in rad, reflectance in 1/sr, linear
RGB) at the centres of measured bins. A bad file that was named ends the conversion and nothing is written; one
found in a folder is skipped with a warning.

Examples:
  metapp data merl BRDFDatabase/brdfs --out merl
  metapp data merl gold.binary steel.binary --split test --out metals
"""
SAMPLES = Setting(
    "samples", 65_536, "Samples (pairs of directions) per material; the first half is for fits to see.", "N", low=2
)

FORMAT = Format(
    "merl",
    "brdf",
    "data_tools.readers.merl",
    "MERL .binary files",
    exports=True,
    noun="MERL file",
    help=HELP,
    paths=("FILES...", ".binary files, and folders searched at any depth."),
    settings=(SAMPLES,),
)
