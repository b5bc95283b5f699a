"""The paper's figures and the report: `--figures` and `--report` of `metapp evaluate`."""

from metapp.door import Option, Report

_HERE = "metapp.extensions.report"
_FIGURES = Option("figures", None, "Draw the figures there, as PNG and PDF.", "DIR")
_PAGE = Option("report", None, "Write one HTML page there: tables, figures, pictures, records.", "DIR")
OFFERS = (
    Report(_FIGURES, f"{_HERE}.figures:write_figures", "*-*.p[nd][gf]"),
    Report(_PAGE, f"{_HERE}.page:write_report", "index.html"),
)
