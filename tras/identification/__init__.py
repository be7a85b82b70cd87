"""A model of any rig from a recording of it: what `make identify` does.

Read `identification` first: it calls the others in their order. `checks` looks at the data, `preparation` scales, smooths and splits
them (`noise`, `smoothing`), `search` compares candidates, `refinement` fits whole trajectories, `bootstrap` gives bands, `scores` and
`advice` judge. `command`, `folder`, `page` and `figures` are the command line and what it writes; `examples` are recordings to try.
"""
