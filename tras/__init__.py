"""Koopman identification of nonlinear systems, at the example of the twin rotor aerodynamic system (TRAS).

The public names are loaded on first use, so that ``import tras`` costs nothing and a script that only simulates the
plant never waits for scikit-learn or xarray.
"""

import importlib

__version__ = "0.1.0"

# Public name -> module that holds it. `tras/staleness.py` reads this table too: keep it a plain dict of strings.
_ROOMS = {
    "PlantParameters": "plant",
    "PrintedPlant": "plant",
    "vector_field": "plant",
    "jacobian": "plant",
    "rest_point": "plant",
    "simulate_plant": "plant",
    "multisine": "excitation",
    "steps": "excitation",
    "chirp": "excitation",
    "Recording": "recording",
    "RecordingError": "roles",
    "remarks": "formats",
    "PID": "closed_loop",
    "simulate_closed_loop": "closed_loop",
    "simulate_closed_loops": "closed_loop",
    "Monomials": "dictionary",
    "Exponentials": "dictionary",
    "Fourier": "dictionary",
    "Union": "dictionary",
    "Product": "dictionary",
    "GaussianRBF": "radial",
    "ThinPlate": "radial",
    "Mechanical": "mechanical",
    "KoopmanModel": "model",
    "choose": "search",
    "candidates": "search",
    "sweep": "sweeps",
    "add_noise": "noise",
    "noise_level": "noise",
    "smooth": "smoothing",
    "identify": "identification",
    "bootstrap": "ensemble",
    "prediction_band": "ensemble",
    "refine": "refinement",
    "lumped_parameters": "physics",
    "parameter_intervals": "physics",
    "load_model": "model",
    "metrics": "metrics",
    "export": "export",
    "open_recording": "lazy",
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
