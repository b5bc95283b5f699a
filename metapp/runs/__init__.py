"""Runs: options of fits, what they name, the loop over inputs, checkpoints, outputs; nothing here prints."""
