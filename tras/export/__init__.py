"""Models for other programs: C, MATLAB, formulas, and the state space of python-control.

Read `common` first, then one of `c`, `matlab` and `equations` (which stands on `expansion` and `symbols`). Public are
the five names below.

Examples
--------
>>> import tras
>>> from tras.identification.examples import example
>>> model = tras.KoopmanModel(tras.Monomials(2), strength=0.01).fit(example("duffing", noise=0)[[0]])
>>> print(tras.export.formulas(model).splitlines()[0])
# Rates (per s) by tras ...; dictionary Monomials(), N = 10; physical units.
"""

from tras.export.c import to_c as to_c
from tras.export.common import to_statespace as to_statespace
from tras.export.controller import controller_to_c as controller_to_c
from tras.export.equations import formulas as formulas
from tras.export.matlab import to_matlab as to_matlab
