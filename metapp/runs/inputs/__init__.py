"""Inputs of fits, from what a user names: `finding` finds them, `refusals` says why a path is none."""
