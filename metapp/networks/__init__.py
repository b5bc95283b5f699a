"""Networks that applications share."""
