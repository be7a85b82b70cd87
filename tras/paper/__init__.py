"""The replication's studies, one per file, in the order of the notebooks.

`validation` (03), `tables` and `figures/` (04), `robustness`, `operators`, `physics` and `systems` (05), `readings`,
`grid` and `effects` (06), `comparison` and `baselines/` (07), `claims` and `errata` (08). `lookups` puts numbers
into prose, `pages` tables into README and docs; `artefacts` and `verification` compare results with the reference.
"""
