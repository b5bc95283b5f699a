"""Non-stationary svBRDFs: maps of a flat material from one to nine photographs under a flash.

Read `maps`, what maps are and how they look under a light; `app`, what all fits share; `coded_maps` with `encoder` and
`variants`, fits of known maps and of one photograph; then `pretrained`, one photograph by features of VGG-16, and
`several`, several photographs, which people take from the `places` that are drawn for training. `recipes` and
`presenter` are as in every application.
"""
