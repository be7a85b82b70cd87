"""Every family of this release by name: what a model's file or a sweep's YAML may ask for."""

from tras.dictionaries.base import Dictionary
from tras.dictionaries.combinations import Product, Union
from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.dictionaries.radial import GaussianRBF, ThinPlate
from tras.dictionaries.waves import Exponentials, Fourier

KINDS: dict[str, type[Dictionary]] = {
    kind.__name__: kind
    for kind in (Monomials, Exponentials, Fourier, GaussianRBF, ThinPlate, Mechanical, Union, Product)
}
