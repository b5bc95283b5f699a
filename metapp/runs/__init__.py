"""Runs: options of fits, recipes, the loop over inputs, checkpoints, outputs; nothing here prints."""
