"""Light paths by their random numbers, which is the space that guided transport learns in.

Read `path_space`, what a point of this space is, samples, and pictures; `next_event`, how paths are traced; and
`resampling`, samples where hardly any path meets a light by chance.
"""
