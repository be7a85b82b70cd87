"""Recordings as files. One format per file.

Read `formats` first: its table has the module of each suffix. `text` reads text tables (`dialect` their layout),
`matlab` MAT files (version 5 by `matfile5`, 7.3 by `matlab73`), `netcdf` and `parquet` theirs. `roles` says which
column is a state, an input or the time, from names (`words`), values (`evidence`, `clock`), or asks (`question`).
`sampling` cuts columns into trajectories of one sampling time, `several` joins files, `limits` holds what the readers
share; `content` checks what a recording takes. `npz` is the gate of models and checkpoints.
"""
