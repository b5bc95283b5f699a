"""The embedded data sets, one module an application, and what they are drawn from."""
