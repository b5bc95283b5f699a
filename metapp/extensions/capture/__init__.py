"""Light and materials captured by hand: `ball` reads a mirror ball, `rectified` flat materials, `lights` lamps.

`hand_photos` has what they do with photographs: display values, outlines of what was found, the import of OpenCV.
"""
