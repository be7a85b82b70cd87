"""Many fits: every point of a grid of options, on local processes or a cluster.

Read `sweep` first; `grid` says what a grid is, `point` fits one point of it, `command` is the command line, `figures`
draws the result.
"""
