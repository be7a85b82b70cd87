"""The rig of the paper: Sec. II and "Data collection".

Read `plant` first (equations of motion), then `excitation` (references) and `closed_loop` (controller and experiment).
`drawing` shows the rig.
"""
