"""Path guiding while rendering: an integrator of Mitsuba 3, and the output `--render` of transport.

`integrator` is the plugin, `guided_picture` renders a picture in parts, and `path_tracer` with `vertex` traces the
paths. `guide_cache` with `histogram` is the spatial cache that they learn; `survey` and `prior` give it a learned
prior. `rendering` makes pictures of tasks.
"""
