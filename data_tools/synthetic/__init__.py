"""The embedded data sets, one module an application, and the models that they are drawn from."""
