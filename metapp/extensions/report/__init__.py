"""The paper's figures and the report: `--figures` and `--report` of `metapp evaluate`."""

from metapp.door import Figure, Option, Report

_HERE = "metapp.extensions.report"
_FIGURES = Option("figures", None, "Draw the figures there, as PNG and PDF.", "DIR")
_PAGE = Option("report", None, "Write one HTML page there: tables, figures, pictures, records.", "DIR")
OFFERS = (
    *(
        Figure(name, f"{_HERE}.drawing:{name}")
        for name in ("plane", "ranks", "curves", "trajectories", "rates", "strips")
    ),
    Report(_FIGURES, f"{_HERE}.figures:write_figures"),
    Report(_PAGE, f"{_HERE}.page:write_report"),
)
