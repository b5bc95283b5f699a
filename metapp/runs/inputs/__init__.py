"""Inputs of fits: files, data sets, objects in memory."""
