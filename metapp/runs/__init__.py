"""What one command does: inputs are found, a specification is completed for each, and fits are made and kept.

In order of reading: `spec` has all that a fit depends on, `inputs` finds what is fitted, `checkpoints` reads what fits
begin at, and `resolve` completes a specification for each input. `fit` is a fit and all that can be made of it, with
`records` as JSON holds it; `fitting` has the one loop that makes fits, `keeping` writes those of a command into their
folders, `stored_fits` reads them back, `fit_pictures` and `fit_tables` show several. `api` has the functions of Python
programs, `checkpoint_training` trains checkpoints, `data_sets` makes data sets, `outputs` writes files of a fit.
`reporter` passes messages on, `environment` and `memory_errors` know the machine.
"""
