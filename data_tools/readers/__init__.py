"""Readers and writers of files, one module a format.

Read these first: `listing` finds files in folders, `input_source` says what a reader finds. `image_files` reads
pictures, which `opened_images` opens, with `colours` and `lenses`; `arrays` and `numbers` read pictures and numbers in
memory.

Readers of BRDFs make tasks by `brdf_task` or `measured_pairs`: `merl`, `nbrdf_files`, `gonio` and `brdf_objects`.
Readers of photographs build on `square_photos`, which reads textures itself: `flash_photos`, and for non-stationary
svBRDFs, whose tasks `svbrdf_task` makes, `svbrdf_inputs`, `strips`, `placed_photos`, `rti_photos`, `material_maps`
with `material_files`, `map_names` and `normal_maps`, and `training_materials`. `light_directions` reads the lights of
`rti_photos`: `light_lines` their text, `named_photos` the files that it names, `light_axes` the axes that it has, and
`ball_places` says where balls are.
`environment_maps` reads light.
"""
