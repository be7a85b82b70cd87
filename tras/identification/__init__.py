"""A model of any rig from a recording of it: what `make identify` does.

Read `identification` first: it calls the others in their order. `preparation` splits and smooths the data (`noise`,
`smoothing`), `checks` looks at them, `search` compares candidates, `bootstrap` gives bands, `scores` and `advice`
judge. `command`, `folder`, `page` and `figures` are the command line and what it writes; `examples` are recordings to
try. `refinement` fits whole trajectories; `make identify` does not use it.
"""
