"""Koopman identification of nonlinear systems, at the example of the twin rotor aerodynamic system (TRAS).

The public names are loaded on first use, so that ``import tras`` costs nothing and a script that only simulates the
plant never waits for scikit-learn or xarray.
"""

import importlib

__version__ = "0.1.0"

# Public name -> module that holds it. `workflow/staleness.py` reads this table too: keep it a plain dict of strings.
_ROOMS = {
    "PlantParameters": "twin_rotor.plant",
    "PrintedPlant": "twin_rotor.plant",
    "vector_field": "twin_rotor.plant",
    "jacobian": "twin_rotor.plant",
    "rest_point": "twin_rotor.plant",
    "simulate_plant": "twin_rotor.plant",
    "multisine": "twin_rotor.excitation",
    "steps": "twin_rotor.excitation",
    "chirp": "twin_rotor.excitation",
    "Recording": "recording",
    "RecordingError": "io.roles",
    "remarks": "io.formats",
    "example": "identification.examples",
    "PID": "twin_rotor.closed_loop",
    "simulate_closed_loop": "twin_rotor.closed_loop",
    "simulate_closed_loops": "twin_rotor.closed_loop",
    "Monomials": "dictionaries.monomials",
    "Exponentials": "dictionaries.waves",
    "Fourier": "dictionaries.waves",
    "Union": "dictionaries.combinations",
    "Product": "dictionaries.combinations",
    "GaussianRBF": "dictionaries.radial",
    "ThinPlate": "dictionaries.radial",
    "Mechanical": "dictionaries.mechanical",
    "KoopmanModel": "model",
    "choose": "identification.search",
    "candidates": "identification.search",
    "sweep": "sweeps.sweep",
    "add_noise": "identification.noise",
    "noise_level": "identification.noise",
    "smooth": "identification.smoothing",
    "identify": "identification.identification",
    "bootstrap": "identification.bootstrap",
    "prediction_band": "identification.bootstrap",
    "refine": "identification.refinement",
    "lumped_parameters": "paper.physics",
    "parameter_intervals": "paper.physics",
    "load_model": "model",
    "metrics": "metrics",
    "export": "export",
    "open_recording": "large.slices",
}

__all__ = [*_ROOMS, "__version__"]


def __getattr__(name):
    room = _ROOMS.get(name)
    if room is None:
        raise AttributeError(f"module 'tras' has no attribute {name!r}; it has {', '.join(sorted(_ROOMS))}")
    module = importlib.import_module(f"tras.{room}")
    return module if name == room else getattr(module, name)


def __dir__():
    return sorted({*globals(), *__all__})
