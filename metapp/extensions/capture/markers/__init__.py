"""A printed sheet of markers round a square opening: its page, and photographs rectified, with the sheet or without.

Markers are ArUco's (Garrido-Jurado et al. 2014), which OpenCV draws and finds.
"""
