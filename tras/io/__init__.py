"""Recordings as files. One format per file.

Read `formats` first: it finds the reader for a path and checks what it gives. `text` reads CSV, `matlab` MAT files (version 5 by
`matfile5`, 7.3 by `matlab73`), `netcdf` and `parquet` theirs. `roles` says which column is a state, an input or the time, `sampling`
cuts columns into trajectories of one sampling time, `limits` holds what the readers share.
"""
