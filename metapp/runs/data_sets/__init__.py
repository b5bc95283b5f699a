"""Data sets: how they are made of files, drawn, joined and checked.

`conversion` makes a data set of a user's files by any format, `embedded` the data sets that metapp draws itself,
`joining` makes one of several, and `checking` verifies one. How a data set lies on disk is known in
`metapp.storage.shards`.
"""
