"""From the options of a fit to a plan."""
