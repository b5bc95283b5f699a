"""Tables of `metapp evaluate` measured by two processes, with what that will take, and rows as they come."""

from metapp.door import CellRunner

OFFERS = (CellRunner("metapp.extensions.side_by_side.measuring:measure"),)
