"""The dictionaries: which functions psi(x, u) lift a state and an input. One family per file.

Read `base` first: it says what every dictionary does and what a new family has to supply. Then `monomials`, `waves`
(exponentials and cosines), `radial` (Gaussians, thin plates), `mechanical` (for rigs that move) `combinations` (unions
and products) and `kinds`, the list of all.
"""
