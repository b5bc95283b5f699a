"""Commands that work as they are, and the input files that they name, for the command `metapp examples`.

`application_examples` has the commands of each application, and `examples_command` prints them.
"""
