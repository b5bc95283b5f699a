"""Light and materials captured by hand: `ball` reads a mirror ball at several exposures, `markers` flat materials.

`hand_photos` has what both do with photographs: display values, outlines of what was found, the import of OpenCV.
"""
