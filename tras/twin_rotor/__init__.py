"""The rig of the paper: Sec. II and "Data collection", and its larger relatives.

Read `plant` first (equations of motion, by the method of `integrator`), then `excitation` (references) and
`closed_loop` (controller and experiment). With rotors: `rotor_parameters` (with `curves`), `rotors`, `gusts`,
`motor_loop`. `drawing` shows the rig.
"""
