"""Which directions of a BRDF to measure, for the command `metapp plan`.

`planning` chooses pairs of directions and draws them, `planned_pairs` writes them and says what to do next, and
`plan_command` is the command.
"""
