"""Extensions: packages that the core never imports, each with a README and tests. None of them imports another.

In order of reading: `contents` has the entries of all of them in the registry. `baselines`, `measures` and `compare`
compare fits with other methods and with each other; `native` takes the steps of fits in C; `plan` chooses measurements;
`capture`, `rgl`, and `scene_files` read further inputs; `vgg` gets weights of VGG-16; `assets`, `shaders`, `rti_files`
and `viewer` write fits for other programs; `mitsuba_bsdfs` and `guided` are plugins for Mitsuba 3; `doctor` and
`examples` help users.
"""
