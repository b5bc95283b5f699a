"""The mathematics of learning, without files, commands or any particular application.

In order of reading: :mod:`task` (what is learned from), :mod:`components` (a decoder, a sight, a judge, an encoder),
:mod:`app` (the application that is made of them), :mod:`adjoint` (one step of learning, and derivatives through many),
:mod:`learn` (descents, and the losses that make Meta out of General), :mod:`rules` (update rules), :mod:`guard` (what
happens to fits by a learned rule that fail), :mod:`recipe` (settings), :mod:`random_tensors` (random numbers),
:mod:`rounding` (absolute values in losses). Nothing here reads or writes a file, or knows a paradigm by its name.
"""
