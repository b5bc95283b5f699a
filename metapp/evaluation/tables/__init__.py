"""The tables of `metapp evaluate`: functions of a `Subject`."""
