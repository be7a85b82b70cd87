"""Models as files: plain arrays and a JSON header in one .npz; loading runs no code from the file.

What a file says is checked before anything is made of it: shapes agree with the names in the header, numbers are finite
and in range, and the dictionary's functions are counted before they are built. `save` checks the same, so that it
writes nothing that `load` refuses.
"""

import json
import math
from pathlib import Path

import numpy as np
from sklearn.base import clone

from tras.dictionaries.kinds import KINDS
from tras.dictionaries.radial import CENTRES
from tras.estimator import Channels
from tras.hull import Hull
from tras.io.npz import read_npz, require_numbers
from tras.predictors import PREDICTORS
from tras.workflow import arguments
from tras.workflow.files import replacing
from tras.workflow.provenance import versions

_FORMAT = "tras model 2"
MAX_FUNCTIONS = 10_000  # of a model, and of a combination of dictionaries before it drops what comes twice
MAX_NESTED = 8  # dictionaries in one another
MAX_SUBSTEPS = 64
_LEAST_SCALE = 1e-100  # of a channel, in its unit
# What a header or an array of the wrong kind makes Python raise.
_WRONG_KIND = (KeyError, TypeError, AttributeError, IndexError, OverflowError, RecursionError)
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
# Parameter of a dictionary -> whether a file may hold the value.
_PARAMETERS = {
    **dict.fromkeys(("degree", "order", "n_centres"), lambda value: _whole(value, 1)),
    **dict.fromkeys(("rate", "period"), lambda value: _positive(value)),
    "width": lambda value: value == "auto" or _positive(value),
    "seed": lambda value: value is None or _whole(value, 0),
    "centres": lambda value: value is None or value in CENTRES,
    **dict.fromkeys(
        ("positions", "velocities", "shape", "actuators"),
        lambda value: value is None or isinstance(value, list) and all(_whole(item, 0) for item in value),
    ),
    "parts": lambda value: value is None,  # they are stored beside
}


def save(model, path):
    """See `tras.KoopmanModel.save`."""
    arrays = {key: value for key in _ARRAYS if (value := getattr(model, key, None)) is not None}
    parameters = {key: value for key, value in model.get_params(deep=False).items() if key != "dictionary"}
    del parameters["max_functions"]  # a limit of a fit, not of the model
    for key, usual in (("lead", 0), ("horizon", 1)):
        if parameters[key] == usual:
            del parameters[key]  # then the file is as earlier releases write and read it
    header = {
        "format": _FORMAT,
        "versions": versions(),
        "parameters": parameters,
        **{key: getattr(model, key + "_") for key in _HEADER},
    }
    if hasattr(model, "errors_"):
        header["errors"] = [[float(key), float(value)] for key, value in model.errors_.items()]
    if getattr(model, "unsettled_", []):
        header["unsettled"] = model.unsettled_
    if model.hull_ is not None:
        arrays |= {f"hull.{key}": value for key, value in model.hull_.arrays().items()}
        header["free"] = [int(i) for i in model.hull_.free]
    header["dictionary"] = _pack(model.dictionary_, "dictionary", arrays)
    text = json.dumps(header)
    try:
        _restored(json.loads(text), {key: np.asarray(value) for key, value in arrays.items()})
    except ValueError as error:
        raise ValueError(f"the model cannot be saved: {error}; fit it anew.") from None
    with replacing(_npz_path(path)) as temporary:
        np.savez(temporary, header=np.array(text), **arrays)


def load(path, make):
    """``make(parameters, dictionary, channels, attributes)`` of a file of `save`; see `tras.load_model`."""
    path = _npz_path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; fit a model and save it with model.save({str(path)!r}).")
    try:
        model = make(*_restored(*read_npz(path, _FORMAT)))
        model.check_options()
        return model
    except (ValueError, *_WRONG_KIND, MemoryError) as error:
        reason = (
            error if isinstance(error, ValueError) else "its header or an array is not of the kind that a model has"
        )
        raise ValueError(
            f"{path} cannot be read as a model ({arguments.one_line(reason)}); save it again with KoopmanModel.save."
        ) from error


def _restored(header, arrays):
    """Parameters, fitted dictionary, channels and attributes of the model that a file holds."""
    labels, parameters = _checked_labels(header), header["parameters"]
    predictor = PREDICTORS.get(parameters["predictor"]) if isinstance(parameters["predictor"], str) else None
    if predictor is None or header["fitted_as"] != [parameters["predictor"], parameters["delays"]]:
        raise ValueError("its predictor or delays are not those of a model")
    delays, functions = parameters["delays"], len(header["names"])
    n, m = len(labels["state_names"]), len(labels["input_names"])
    z = n * (delays + 1) + m * delays * bool(predictor.delays_inputs)
    if 1 + z + m * predictor.lifts_inputs > functions:
        raise ValueError(f"{n} states and {m} inputs with {delays} delays are more than its {functions} functions")
    dictionary = _unpack(header["dictionary"], "dictionary", arrays, (z, m * predictor.lifts_inputs))
    if dictionary.size != functions:
        raise ValueError(f"its dictionary has {dictionary.size} functions, its header names {functions}")
    scales = {
        key: require_numbers(f"{key}_", arrays.pop(f"{key}_"), (n if key[0] == "x" else m,), low)
        for key, low in zip(_SCALES, (-1e100, _LEAST_SCALE) * 2)
    }
    lead = parameters.get("lead", 0)  # files of earlier releases have none
    arguments.whole_number("its lead", lead, 0, 1)
    channels = Channels(**labels, **scales, delays=delays, delayed_inputs=predictor.delays_inputs, lead=lead)
    attributes = {"hull_": None, "outward_": None, "outward_step_": None}
    if "hull.centre" in arrays:
        parts = {key: arrays.pop(f"hull.{key}") for key in ("centre", "axes", "low", "high")}
        free = _free(header["free"], z + m, len(parts["centre"]))
        attributes["hull_"] = Hull.restored(parts, free, dictionary.margin)
    if "errors" in header:
        attributes["errors_"] = _errors(header["errors"])
    attributes["unsettled_"] = header.get("unsettled", [])
    if not isinstance(attributes["unsettled_"], list) or not all(map(_is_sentence, attributes["unsettled_"])):
        raise ValueError("its unsettled are no list of sentences")
    attributes |= {f"{key}_": header[key] for key in ("names", "pairs", "rank", "strength")}
    attributes["fitted_as_"] = tuple(header["fitted_as"])
    attributes |= _checked_arrays(arrays, parameters, functions, z, m, attributes["hull_"] is not None)
    return parameters, dictionary, channels, attributes


def _checked_labels(header):
    """Sampling time, names and units of the channels; a ValueError if a field of the header is out of range."""
    missing = [key for key in (*_HEADER, "parameters", "dictionary") if key not in header]
    if missing:
        raise ValueError(f"its header lacks {missing[0]!r}")
    names, units = ("state_names", "input_names"), ("state_units", "input_units")
    for key in (*names, *units, "names"):
        value = header[key]
        if not isinstance(value, list) or not all(isinstance(word, str) and _is_text(word) for word in value):
            raise ValueError(f"its {key} are no list of texts")
    channels = [*header["state_names"], *header["input_names"]]
    if not header["state_names"] or len(set(channels)) < len(channels):
        raise ValueError("its channels have no names, or one twice")
    if any(len(header[name]) != len(header[unit]) for name, unit in zip(names, units)):
        raise ValueError("its channels and units are not one for one")
    functions = len(header["names"])
    if not 1 < functions <= MAX_FUNCTIONS:
        raise ValueError(f"it has {functions} functions, up to {MAX_FUNCTIONS} are read")
    arguments.number("its dt", header["dt"], _LEAST_SCALE, 1e100)
    arguments.number("its strength", header["strength"], 0)
    arguments.whole_number("its pairs", header["pairs"], 1, 2**63)
    arguments.whole_number("its rank", header["rank"], 0, functions + len(channels))
    arguments.whole_number("its delays", header["parameters"]["delays"], 0, MAX_FUNCTIONS)
    return {key: value if key == "dt" else tuple(value) for key in _LABELS for value in [header[key]]}


def _free(free, channels, length):
    if length != channels or not isinstance(free, list) or not all(_whole(i, 0) and i < channels for i in free):
        raise ValueError(f"its hull is not one of its {channels} channels")
    return free


def _is_sentence(value):
    return isinstance(value, str) and _is_text(value) and len(value) <= 1000


def _errors(errors):
    """Strength -> error; infinite where there was no model."""
    if not isinstance(errors, list) or not all(
        isinstance(pair, list) and len(pair) == 2 and all(isinstance(x, float) and x >= 0 for x in pair)
        for pair in errors
    ):
        raise ValueError("its errors are no pairs of strength and error")
    return dict(map(tuple, errors))


def _checked_arrays(arrays, parameters, N, z, m, has_hull):
    """The arrays as a model has them; a ValueError on one too many, too few, of another shape, or out of range."""
    predictor, states = parameters["predictor"], parameters.get("columns") == "states"
    shapes = {"koopman_matrix": (N, z) if states else (N, N), "condition_number": (), "residual_": (None,)}
    needed = set(shapes)
    if predictor == "vector_field":
        shapes |= {"generator": (N, N), "W_": (z, N), "substeps_": (), "log_residual_": ()}
        shapes |= {"field_disagreement_": (None,), "refinement_": (None,)}
        needed |= {"generator", "W_", "substeps_", "log_residual_"}
    if predictor == "one_step":
        shapes |= {"refinement_": (None,)}
    if predictor == "lifted_linear":
        shapes |= {"B_": (N, m)}
        needed |= {"B_"}
    if has_hull:
        slopes = {"outward_": (z, z + m), "outward_step_": (z, z + m)}
        shapes, needed = shapes | slopes, needed | set(slopes)
    if not needed <= set(arrays):
        raise ValueError(f"it lacks {sorted(needed - set(arrays))[0]!r}")
    attributes = {}
    for key, array in arrays.items():
        if key not in shapes:
            raise ValueError(f"it holds {key[:40]!r}, which is no part of such a model")
        if key == "condition_number" and array.dtype.kind == "f" and array.shape == () and array == math.inf:
            attributes[key] = math.inf  # of functions that depend on each other
            continue
        whole = key == "substeps_"
        low = 1 if whole else -1e100 if len(shapes[key]) == 2 else 0
        require_numbers(key, array, shapes[key], low)
        if whole and not (array.dtype.kind == "i" and array <= MAX_SUBSTEPS):
            raise ValueError(f"its substeps_ is {array}, a model has 1 to {MAX_SUBSTEPS}")
        if key == "refinement_" and not array.size:
            raise ValueError("its refinement_ is empty")
        attributes[key] = array.item() if array.ndim == 0 else array
    return attributes


def _whole(value, low):
    return isinstance(value, int) and not isinstance(value, bool) and low <= value < 2**128


def _positive(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and _LEAST_SCALE <= value <= 1e100


def _is_text(word):
    """Whether it can be written: without halves of pairs of UTF-16."""
    return len(word) <= 10_000 and not any("\ud800" <= letter <= "\udfff" for letter in word)


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
        if key == "actuators" and value is None:
            continue  # then the file is as earlier releases write and read it
        if key in ("positions", "velocities", "shape", "actuators") and value is not None:
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


def _unpack(header, place, arrays, channels, depth=0):
    """The dictionary that `_pack` has packed, of so many states and inputs; its arrays are taken out of ``arrays``."""
    name = header["name"]
    kind = KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise ValueError(f"its dictionary {arguments.short(repr(name))} is not one of this release")
    combines, known = "parts" in kind._get_param_names(), kind().get_params(deep=False)
    for key, value in header["parameters"].items():
        if key not in known or not _PARAMETERS[key](value):
            raise ValueError(f"its dictionary {name} has {arguments.short(f'{key} = {value!r}')}")
    stored = header.get("parts", [])
    if combines != bool(stored) or depth > MAX_NESTED or not isinstance(stored, list) or len(stored) > 100:
        raise ValueError(f"its dictionary {name} is not made of the parts that it needs")
    parts = [_unpack(part, f"{place}.{i}", arrays, channels, depth + 1) for i, part in enumerate(stored)]
    dictionary = kind(**(header["parameters"] | ({"parts": [clone(part) for part in parts]} if parts else {})))
    if parts:
        dictionary.parts_ = parts
    learnt = {key: arrays.pop(key) for key in [key for key in arrays if key.rpartition(".")[0] == place]}
    for key, value in _learnt(learnt, place, dictionary, channels).items():
        setattr(dictionary, key, value)
    if hasattr(dictionary, "centres_") and None in (dictionary.seed, dictionary.centres):
        # Drawn by a Generator, or given: fitted again, the model has the same ones.
        dictionary.centres = dictionary.centres_
        dictionary.seed = 0 if dictionary.seed is None else dictionary.seed
    if dictionary.count() > MAX_FUNCTIONS:
        raise ValueError(f"its dictionary {name} has more than {MAX_FUNCTIONS} functions")
    return dictionary.restore()


def _learnt(arrays, place, dictionary, channels):
    """What a dictionary of so many states and inputs learnt, attribute -> value, each checked."""
    shapes = {"n_states_": (), "n_inputs_": ()}
    if hasattr(dictionary, "parts_"):
        shapes["kept_"] = (None,)
    elif "centres" in dictionary.get_params(deep=False):
        shapes |= {"centres_": (None, sum(channels)), "width_": ()}
    elif getattr(dictionary, "actuators", None):
        shapes["origin_"] = (sum(channels),)
    values = {key.rpartition(".")[2]: value for key, value in arrays.items()}
    if set(values) != set(shapes):
        raise ValueError(f"it lacks what its dictionary {type(dictionary).__name__} has learnt, or has more")
    for key, value in values.items():
        require_numbers(f"{place}.{key}", value, shapes[key], _LEAST_SCALE if key == "width_" else -1e100)
    fractional = any(values[key].dtype.kind not in "iu" for key in ("n_states_", "n_inputs_"))
    values = {key: value.item() if value.ndim == 0 else value for key, value in values.items()}
    if (values["n_states_"], values["n_inputs_"]) != channels or fractional:
        raise ValueError(f"its dictionary is not of {channels[0]} states and {channels[1]} inputs")
    if "kept_" in values:
        _check_choice(values["kept_"], dictionary, 1 + sum(channels))
    return values


def _check_choice(kept, combination, head):
    """``kept`` are numbers of functions of the parts, each once, the constant and the channels first."""
    sizes = [part.size for part in combination.parts_]
    if type(combination) is KINDS["Product"] and len(sizes) != 2:
        raise ValueError("its Product is not one of two dictionaries")
    most = math.prod(sizes) if type(combination) is KINDS["Product"] else sum(sizes)
    if most > MAX_FUNCTIONS:
        raise ValueError(f"its dictionary has {most} functions in its parts, up to {MAX_FUNCTIONS} are read")
    sound = kept.dtype.kind == "i" and len(kept) >= head and (kept[:head] == np.arange(head)).all()
    sound = sound and 0 <= kept.min() and kept.max() < most  # before differences, which may overflow
    if not (sound and (np.diff(kept) > 0).all()):
        raise ValueError("its dictionary chooses functions that its parts do not have")


def _npz_path(path):
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path {path} ends in {path.suffix!r}; models are stored with the ending .npz.")
    return path
