"""`metapp compare`: runs side by side."""
