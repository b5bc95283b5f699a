"""Interactive pages of fits: one HTML file each, which needs no server and loads nothing.

`page.py` writes it; `scripts/` holds the viewers, and `three.min.js` what they draw with: three.js, of the version and
by the command in `tools/three.sh`, under the MIT licence (`LICENSE.three`).
"""
