"""Models as files: plain arrays and a JSON header in one .npz; loading runs no code from the file."""

import json
import zipfile
from pathlib import Path

import numpy as np
from sklearn.base import clone

from tras.dictionaries.kinds import KINDS
from tras.estimator import Channels
from tras.hull import Hull
from tras.predictors import PREDICTORS
from tras.workflow.files import replacing
from tras.workflow.provenance import versions

_FORMAT = "tras model 2"
# What reading a damaged file, and making something of what it holds, may raise.
UNREADABLE = (OSError, EOFError, KeyError, TypeError, AttributeError, IndexError, ValueError, zipfile.BadZipFile)
_HEADER = (
    "dt",
    "fitted_as",
    "state_names",
    "state_units",
    "input_names",
    "input_units",
    "names",
    "pairs",
    "rank",
    "strength",
)
_ARRAYS = (
    "koopman_matrix", "generator", "W_", "B_", "condition_number", "residual_", "field_disagreement_", "substeps_",
    "x_offset_", "x_scale_", "u_offset_", "u_scale_", "outward_", "outward_step_", "log_residual_", "refinement_",
)  # fmt: skip
_LABELS = ("dt", "state_names", "state_units", "input_names", "input_units")
_SCALES = ("x_offset", "x_scale", "u_offset", "u_scale")


def save(model, path):
    """See `tras.KoopmanModel.save`."""
    arrays = {key: value for key in _ARRAYS if (value := getattr(model, key, None)) is not None}
    parameters = {key: value for key, value in model.get_params(deep=False).items() if key != "dictionary"}
    header = {
        "format": _FORMAT,
        "versions": versions(),
        "parameters": parameters,
        **{key: getattr(model, key + "_") for key in _HEADER},
    }
    if hasattr(model, "errors_"):
        header["errors"] = [[float(key), float(value)] for key, value in model.errors_.items()]
    if model.hull_ is not None:
        arrays |= {f"hull.{key}": value for key, value in model.hull_.arrays().items()}
        header["free"] = [int(i) for i in model.hull_.free]
    header["dictionary"] = _pack(model.dictionary_, "dictionary", arrays)
    with replacing(_npz_path(path)) as temporary:
        np.savez(temporary, header=np.array(json.dumps(header)), **arrays)


def load(path, make):
    """``make(parameters, dictionary, channels, attributes)`` of a file of `save`; see `tras.load_model`."""
    path = _npz_path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; fit a model and save it with model.save({str(path)!r}).")
    try:
        return make(*_restored(*read_npz(path, _FORMAT)))
    except UNREADABLE as error:
        raise ValueError(
            f"{path} cannot be read as a model ({error}); save it again with KoopmanModel.save."
        ) from error


def read_npz(path, form):
    """(header, arrays) of an .npz file whose JSON header must name the format ``form``; raises one of `UNREADABLE`."""
    with np.load(path, allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    header = json.loads(str(arrays.pop("header")))
    if header["format"] != form:
        raise ValueError(f"its format is {header['format']!r}, this release reads {form!r}")
    return header, arrays


def _restored(header, arrays):
    """Parameters, fitted dictionary, channels and attributes of the model that a file holds."""
    parameters, dictionary = header["parameters"], _unpack(header["dictionary"], "dictionary", arrays)
    attributes = {"hull_": None, "outward_": None, "outward_step_": None}
    if "hull.centre" in arrays:
        attributes["hull_"] = Hull.restored(
            {key: arrays.pop(f"hull.{key}") for key in ("centre", "axes", "low", "high")}, header["free"]
        )
    if "errors" in header:
        attributes["errors_"] = dict(map(tuple, header["errors"]))
    header = {
        key: tuple(value) if isinstance(value := header[key], list) and key != "names" else value for key in _HEADER
    }
    attributes |= {f"{key}_": value for key, value in header.items() if key not in _LABELS}
    for key, value in arrays.items():
        if key not in _ARRAYS:
            raise ValueError(f"it holds {key!r}, which is no part of a model")
        attributes[key] = value.item() if value.ndim == 0 else value
    needed = {"koopman_matrix", *(f"{key}_" for key in _SCALES)}
    needed |= {"vector_field": {"W_", "substeps_", "generator"}, "lifted_linear": {"B_"}}.get(
        parameters["predictor"], set()
    )
    if not needed <= set(arrays):
        raise ValueError(f"it lacks {sorted(needed - set(arrays))[0]!r}")
    scales = {key: attributes.pop(f"{key}_") for key in _SCALES}
    labels, delayed_inputs = {key: header[key] for key in _LABELS}, PREDICTORS[parameters["predictor"]].delays_inputs
    channels = Channels(
        **labels, **scales, delays=parameters["delays"], delayed_inputs=delayed_inputs, lead=parameters.get("lead", 0)
    )
    return parameters, dictionary, channels, attributes


def _pack(dictionary, place, arrays):
    """A fitted dictionary as JSON holds it; its learnt arrays go into ``arrays``, named from ``place`` on."""
    name = type(dictionary).__name__
    if KINDS.get(name) is not type(dictionary):
        raise ValueError(
            f"dictionary {name!r} is not one of this package, so a file with it could not be read; "
            "keep the code that makes it."
        )
    header = {"name": name, "parameters": {}}
    for key, value in dictionary.get_params(deep=False).items():
        if isinstance(value, np.generic):
            value = value.item()
        if key in ("positions", "velocities", "shape") and value is not None:
            value = [int(i) for i in value]
        # What the parts, a Generator or an array of centres led to is among the learnt.
        header["parameters"][key] = (
            value if value is None or isinstance(value, (bool, int, float, str, list)) and key != "parts" else None
        )
    for key, value in vars(dictionary).items():
        if key == "parts_":
            header["parts"] = [_pack(part, f"{place}.{i}", arrays) for i, part in enumerate(value)]
        elif key.endswith("_"):
            arrays[f"{place}.{key}"] = value
    return header


def _unpack(header, place, arrays):
    """The dictionary that `_pack` has packed; its arrays are taken out of ``arrays``."""
    kind = KINDS.get(header["name"])
    if kind is None:
        raise ValueError(f"its dictionary {header['name']!r} is not one of this release")
    parts = [_unpack(part, f"{place}.{i}", arrays) for i, part in enumerate(header.get("parts", []))]
    dictionary = kind(**(header["parameters"] | ({"parts": [clone(part) for part in parts]} if parts else {})))
    if parts:
        dictionary.parts_ = parts
    for key in [key for key in arrays if key.rpartition(".")[0] == place]:
        value = arrays.pop(key)
        setattr(dictionary, key.rpartition(".")[2], value.item() if value.ndim == 0 else value)
    if hasattr(dictionary, "centres_") and None in (dictionary.seed, dictionary.centres):
        dictionary.centres = (
            dictionary.centres_
        )  # drawn by a Generator, or given: fitted again, the model has the same ones
        dictionary.seed = 0 if dictionary.seed is None else dictionary.seed
    return dictionary.restore()


def _npz_path(path):
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path {path} ends in {path.suffix!r}; models are stored with the ending .npz.")
    return path
