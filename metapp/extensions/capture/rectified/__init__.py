"""Flat materials in hand-held photographs: rectified by a printed sheet of markers, or by the material's own features.

`sheet` has the places of the markers, `sheet_page` draws the sheet, and `sighting` finds it and the camera in a
photograph. Without a sheet, `registration` places photographs on one of them by `features`, `plane` finds cameras,
`sample` cuts away a table around the material. `rectified_photos` brings both ways together, `rectification` and
`marker_commands` write the results by the options in `marker_options`, and `found_outlines` shows what was found where
photographs cannot be rectified. Markers are ArUco's (Garrido-Jurado et al. 2014), which OpenCV draws and finds.
"""
