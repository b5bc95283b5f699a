"""Interactive HTML pages of fits."""
