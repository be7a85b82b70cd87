"""Koopman identification of nonlinear systems, at the example of the twin rotor aerodynamic system (TRAS).

Start here:

    import tras
    log = tras.Recording.read("log.csv")          # or tras.example("duffing") to try
    log.plot()                                    # every channel over time
    train, test = log.cut(101).split(0.8, 0)      # trajectories of 101 samples, four fifths of them to fit
    model, tried = tras.choose(train)             # or tras.KoopmanModel(tras.Monomials(2)).fit(train)
    print(model.report(test))                     # conditioning, stability, errors of predictions
    tras.compare(test, model)                     # measured against simulated: figure and table
    model.plot_spectrum()                         # eigenvalues beside the unit circle
    states = model.simulate(log.states[0][0], log.inputs[0])
    model.save("model.npz")                       # tras.load_model reads it
    result = tras.identify(log)                   # or all of it in one call: result.advice, result.plot()
    tras.export.to_c(model, "model.c")            # C, MATLAB, formulas, state space

The public names are loaded on first use: ``import tras`` costs nothing, and a script that only simulates the plant
never waits for scikit-learn. ``dir(tras)`` lists them.
"""

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Public name -> module that holds it. `workflow/staleness.py` reads this table too: keep it a plain dict of strings.
_ROOMS = {
    "PlantParameters": "twin_rotor.plant",
    "PrintedPlant": "twin_rotor.plant",
    "vector_field": "twin_rotor.plant",
    "jacobian": "twin_rotor.plant",
    "rest_point": "twin_rotor.plant",
    "simulate_plant": "twin_rotor.plant",
    "RotorParameters": "twin_rotor.rotor_parameters",
    "simulate_rotors": "twin_rotor.rotors",
    "simulate_motor_loop": "twin_rotor.motor_loop",
    "gusts": "twin_rotor.gusts",
    "multisine": "twin_rotor.excitation",
    "steps": "twin_rotor.excitation",
    "chirp": "twin_rotor.excitation",
    "Recording": "recording",
    "RecordingError": "io.roles",
    "remarks": "io.formats",
    "example": "identification.examples",
    "PID": "twin_rotor.closed_loop",
    "LQR": "control.lqr",
    "MPC": "control.mpc",
    "Observer": "control.observer",
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
    "compare": "display.plots",
    "metrics": "metrics",
    "export": "export",
    "open_recording": "large.slices",
}

# The same for editors and type checkers, which run none of this; tests/test_surface.py compares the two.
if TYPE_CHECKING:
    from tras import export as export
    from tras import metrics as metrics
    from tras.control.lqr import LQR as LQR
    from tras.control.mpc import MPC as MPC
    from tras.control.observer import Observer as Observer
    from tras.dictionaries.combinations import Product as Product
    from tras.dictionaries.combinations import Union as Union
    from tras.dictionaries.mechanical import Mechanical as Mechanical
    from tras.dictionaries.monomials import Monomials as Monomials
    from tras.dictionaries.radial import GaussianRBF as GaussianRBF
    from tras.dictionaries.radial import ThinPlate as ThinPlate
    from tras.dictionaries.waves import Exponentials as Exponentials
    from tras.dictionaries.waves import Fourier as Fourier
    from tras.display.plots import compare as compare
    from tras.identification.bootstrap import bootstrap as bootstrap
    from tras.identification.bootstrap import prediction_band as prediction_band
    from tras.identification.examples import example as example
    from tras.identification.identification import identify as identify
    from tras.identification.noise import add_noise as add_noise
    from tras.identification.noise import noise_level as noise_level
    from tras.identification.refinement import refine as refine
    from tras.identification.search import candidates as candidates
    from tras.identification.search import choose as choose
    from tras.identification.smoothing import smooth as smooth
    from tras.io.formats import remarks as remarks
    from tras.io.roles import RecordingError as RecordingError
    from tras.large.slices import open_recording as open_recording
    from tras.model import KoopmanModel as KoopmanModel
    from tras.model import load_model as load_model
    from tras.paper.physics import lumped_parameters as lumped_parameters
    from tras.paper.physics import parameter_intervals as parameter_intervals
    from tras.recording import Recording as Recording
    from tras.sweeps.sweep import sweep as sweep
    from tras.twin_rotor.closed_loop import PID as PID
    from tras.twin_rotor.closed_loop import simulate_closed_loop as simulate_closed_loop
    from tras.twin_rotor.closed_loop import simulate_closed_loops as simulate_closed_loops
    from tras.twin_rotor.excitation import chirp as chirp
    from tras.twin_rotor.excitation import multisine as multisine
    from tras.twin_rotor.excitation import steps as steps
    from tras.twin_rotor.gusts import gusts as gusts
    from tras.twin_rotor.motor_loop import simulate_motor_loop as simulate_motor_loop
    from tras.twin_rotor.plant import PlantParameters as PlantParameters
    from tras.twin_rotor.plant import PrintedPlant as PrintedPlant
    from tras.twin_rotor.plant import jacobian as jacobian
    from tras.twin_rotor.plant import rest_point as rest_point
    from tras.twin_rotor.plant import simulate_plant as simulate_plant
    from tras.twin_rotor.plant import vector_field as vector_field
    from tras.twin_rotor.rotor_parameters import RotorParameters as RotorParameters
    from tras.twin_rotor.rotors import simulate_rotors as simulate_rotors

if not TYPE_CHECKING:  # to an editor every name would exist, and none have a type
    __all__ = [*_ROOMS, "__version__"]

    def __getattr__(name):
        room = _ROOMS.get(name)
        if room is None:
            raise AttributeError(f"module 'tras' has no attribute {name!r}; it has {', '.join(sorted(_ROOMS))}")
        module = importlib.import_module(f"tras.{room}")
        return module if name == room else getattr(module, name)

    def __dir__():
        return sorted(__all__)
