"""Commands of each application that work as they are, and the result of each in words.

A command is the words after `metapp`, with {} in place of the folder of inputs.
"""

BRDF_EXAMPLES = (
    ("meta brdf {}/paint.csv", "a network fitted to a table of measurements, and a picture of both"),
    (
        "meta brdf {}/paint.csv --export merl,mitsuba",
        "that network as a MERL table and as a material for Mitsuba",
    ),
    ("quickft brdf {}/paint.csv", "the network fitted by a tuned Adam of as many steps, to compare"),
    ("baseline brdf {}/paint.csv --method ggx_2", "two GGX lobes fitted without a network"),
    (
        "plan brdf --samples 16 --out {}/plan.csv",
        "which 16 pairs of directions to measure, as a table to fill in",
    ),
)
ILLUMINATION_EXAMPLES = (
    ("general illumination {}/lobby.exr", "an environment map as a network, by one forward pass"),
    (
        "meta illumination {}/lobby.exr --size 256x512",
        "a map fitted in a few learned steps, as EXR of 256 rows",
    ),
    ("meta illumination {}/ball.png", "an HDR map of one LDR photo of a mirror ball"),
    ("data ball {}/ball.png --out {}/ball", "the light that the ball mirrors, without a network"),
    ("baseline illumination {}/lobby.exr --method sh", "the map as spherical harmonics, to compare"),
)
SVBRDF_NONSTATIONARY_EXAMPLES = (
    (
        "general svbrdf_nonstationary {}/mosaic.png",
        "maps of a flash photo, by one forward pass",
    ),
    ("meta svbrdf_nonstationary {}/mosaic.png", "maps fitted in a few learned steps"),
    (
        "meta svbrdf_nonstationary {}/mosaic.png --export blender,gltf",
        "maps for Blender, and a material in glTF",
    ),
    ("quickft svbrdf_nonstationary {}/mosaic.png", "maps fitted by a tuned Adam, to compare"),
    ("baseline svbrdf_nonstationary {}/mosaic.png --method flat", "the photo itself as a flat diffuse map, to compare"),
)
SVBRDF_STATIONARY_EXAMPLES = (
    (
        "baseline svbrdf_stationary {}/leather.png --method quilting",
        "maps quilted of a flash photo, without a network",
    ),
    ("general svbrdf_stationary {}/leather.png", "tiling maps of a flash photo, by one forward pass"),
    ("general svbrdf_stationary {}/leather.png --export gltf", "maps as a material in glTF"),
    ("meta svbrdf_stationary {}/leather.png", "maps fitted in a few learned steps"),
    ("meta svbrdf_stationary {}/leather.png --size 512x512 --export blender", "maps of 512 px for Blender"),
)
TEXTURE_EXAMPLES = (
    ("baseline texture {}/bricks.png --method quilting", "a texture quilted of the photo, without a network"),
    ("general texture {}/bricks.png", "a texture like the photo, by one forward pass"),
    ("meta texture {}/bricks.png", "a texture fitted in a few learned steps"),
    ("meta texture {}/bricks.png --size 512x768 --export png16", "a texture of 512 x 768 px as PNG of 16 bits"),
    ("quickft texture {}/bricks.png", "a texture fitted by a tuned Adam of as many steps, to compare"),
)
TRANSPORT_EXAMPLES = (
    (
        "general transport {}/box.xml",
        "the light paths of a scene as a density, by one forward pass; renders by it",
    ),
    ("meta transport {}/box.xml", "the density fitted in a few learned steps"),
    ("quickft transport {}/box.xml", "the density fitted by a tuned Adam of as many steps, to compare"),
    ("data cornell --count 2 --out {}/boxes", "two random Cornell boxes, traced, as a data set"),
    ("meta transport {}/box.xml --render 64", "the scene guided at all bounces, and unguided in the same time"),
)
