"""Help of `metapp data gonio`."""

from dataclasses import dataclass

from metapp.options import Converter


@dataclass(frozen=True)
class Gonio(Converter):
    """Convert goniometer measurements, CSV files.

    A line of column names, then a row for each pair of directions: theta_i_deg, phi_i_deg (light), theta_o_deg,
    phi_o_deg (detector), or _rad for radians, and the BRDF in 1/sr as r, g, b (linear RGB) or as wavelengths (400nm,
    410nm, ...). Semicolons, tabs, quotes, decimal commas, a row of units and UTF-16, as spreadsheets write, are read as
    well. A negative theta is at phi + 180 degrees. Lines that begin with # are comments. The measurements themselves
    are the samples, in random order; a bad file that was named ends the conversion and nothing is written; one found in
    a folder is skipped with a warning.

    Examples:
      metapp data gonio paint.csv --out measured
      metapp data gonio measurements --split test --out measured
    """
