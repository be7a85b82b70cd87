"""The panel of `notebooks/explore.ipynb`.

Read `choice` first (what can be set), then `explore` (what a choice leads to). `widgets` is the panel, with what
`further` shows on demand; `figures` draws, also what `portraits` computes.
"""
