"""`metapp compare`: two runs side by side."""
