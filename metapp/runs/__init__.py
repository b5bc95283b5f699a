"""Runs: what one command or one call of the Python API does, from options to fits. Nothing here prints or exits.

In order of reading: `fit_options` has all that a user may choose, `inputs` finds and reads what is fitted, `choice`
chooses what options leave open, `checkpoint_selection` and `checkpoint_training` provide phi, `fitter` fits tasks,
`fit` is one result, `outputs` writes files and reads records, `execution` does a whole command, and `api` has the
functions for Python programs. `data_sets` makes data sets and checks them.
`environment` (device, threads, versions), `memory_errors` and `reporter` (messages and progress) serve all of them.
"""
