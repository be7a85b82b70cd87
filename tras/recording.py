"""`Recording`: measured or simulated trajectories with names, units and sampling time (paper, "Data collection")."""

import math
from pathlib import Path

import numpy as np

from tras.files import replacing

_FORMAT = "tras recording 1"


class Recording:
    """Trajectories of one system, all with the same channels and sampling time; lengths may differ.

    Parameters
    ----------
    states : (trajectories, samples, n) array_like or list of (samples_i, n)
        What is to be predicted; ``n >= 1``.
    inputs : (trajectories, samples, m) array_like or list of (samples_i, m), optional
        What acts from outside, sample ``k`` held from sample ``k`` to ``k + 1``. None for an autonomous system.
    dt : float
        Sampling time in s.
    state_names, input_names : sequence of str, optional
        Default ``x1, x2, ...`` and ``u1, u2, ...``.
    state_units, input_units : sequence of str, optional
        Default: unknown, ``""``.
    attributes : dict, optional
        Name -> number, string or sequence of numbers: what a reader needs to know about the origin.

    Raises
    ------
    ValueError
        On wrong shapes, unequal lengths of states and inputs, empty trajectories, NaN or infinity (with the place), names
        that repeat or do not match in number, a sampling time that is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> r = Recording(np.zeros((1, 50001, 4)), np.zeros((1, 50001, 2)), 0.01).cut(501)
    >>> len(r), r.states.shape, r.pairs
    (100, (100, 501, 4), 50000)
    """

    # No attribute `shape` here: with __len__ and __getitem__ alone scikit-learn splits a recording by trajectories.

    def __init__(
        self, states, inputs=None, dt=None, *, state_names=None, input_names=None, state_units=None, input_units=None, attributes=None
    ):
        if dt is None or not (math.isfinite(dt) and dt > 0):
            raise ValueError(f"dt is {dt}; give the sampling time in s, a positive number.")
        self.dt = float(dt)
        self._states = _trajectories("states", states)
        if not self._states:
            raise ValueError("states holds no trajectory; give at least one.")
        if inputs is None:
            inputs = [np.empty((len(x), 0)) for x in self._states]
        self._inputs = _trajectories("inputs", inputs)
        if len(self._inputs) != len(self._states):
            raise ValueError(f"inputs has {len(self._inputs)} trajectories but states has {len(self._states)}; give one for one.")
        for i, (x, u) in enumerate(zip(self._states, self._inputs)):
            if len(x) != len(u):
                raise ValueError(f"trajectory {i} has {len(x)} samples of states but {len(u)} of inputs; they must be equal.")
        if self._states[0].shape[1] == 0:
            raise ValueError("states has no channel; give at least one.")
        self.state_names, self.state_units = _labels("state", "x", self._states, state_names, state_units)
        self.input_names, self.input_units = _labels("input", "u", self._inputs, input_names, input_units)
        shared = set(self.state_names) & set(self.input_names)
        if shared:
            raise ValueError(f"the name {sorted(shared)[0]!r} stands for a state and for an input; rename one.")
        for names, trajectories in ((self.state_names, self._states), (self.input_names, self._inputs)):
            _check_finite(names, trajectories)
        self.attributes = dict(attributes or {})

    @property
    def states(self):
        """(trajectories, samples, n) array; a list of (samples_i, n) when the lengths differ."""
        return _together(self._states)

    @property
    def inputs(self):
        """(trajectories, samples, m) array; a list of (samples_i, m) when the lengths differ."""
        return _together(self._inputs)

    @property
    def lengths(self):
        """Samples of each trajectory, (trajectories,)."""
        return np.array([len(x) for x in self._states])

    @property
    def pairs(self):
        """Number of snapshot pairs (12): one less than samples in each trajectory."""
        return int(np.sum(self.lengths - 1))

    @property
    def n(self):
        """Number of states."""
        return len(self.state_names)

    @property
    def m(self):
        """Number of inputs."""
        return len(self.input_names)

    def __len__(self):
        return len(self._states)

    def __iter__(self):
        """Trajectories as pairs ``(states (samples, n), inputs (samples, m))``, no copies."""
        return zip(self._states, self._inputs)

    def __getitem__(self, index):
        """A recording of the trajectory or trajectories at an integer, slice, list of integers or boolean mask."""
        chosen = np.arange(len(self))[index]
        return self._with([self._states[i] for i in np.atleast_1d(chosen)], [self._inputs[i] for i in np.atleast_1d(chosen)])

    def __repr__(self):
        lengths = self.lengths
        samples = f"{lengths[0]}" if np.all(lengths == lengths[0]) else f"{lengths.min()} to {lengths.max()}"
        channels = f"states {', '.join(self.state_names)}; inputs {', '.join(self.input_names) or 'none'}"
        return f"Recording: {len(self)} trajectories of {samples} samples at {self.dt:g} s; {channels}"

    def select(self, *, states=None, inputs=None):
        """The same trajectories with only the named channels, in the order given.

        Raises
        ------
        ValueError
            If a name is not among the channels.
        """
        x = _columns("states", self.state_names, states)
        u = _columns("inputs", self.input_names, inputs)
        return self._with(
            [a[:, x] for a in self._states],
            [a[:, u] for a in self._inputs],
            state_names=[self.state_names[i] for i in x],
            state_units=[self.state_units[i] for i in x],
            input_names=[self.input_names[i] for i in u],
            input_units=[self.input_units[i] for i in u],
        )

    def cut(self, samples):
        """Cut every trajectory into pieces of ``samples`` samples that share their end points; a shorter rest is dropped.

        50001 samples give 100 pieces of 501, with all of their 50000 snapshot pairs.

        Raises
        ------
        ValueError
            If ``samples`` is less than 2 or no trajectory is that long.
        """
        if samples < 2 or samples > self.lengths.max():
            raise ValueError(f"samples = {samples}; pieces need 2 to {self.lengths.max()} samples, the longest trajectory's length.")
        starts = [(x, u, k) for x, u in self for k in range(0, len(x) - samples + 1, samples - 1)]
        return self._with([x[k : k + samples] for x, _, k in starts], [u[k : k + samples] for _, u, k in starts])

    def split(self, fraction, seed):
        """Two recordings: a random ``fraction`` of the trajectories, and the rest, each in the old order.

        Raises
        ------
        ValueError
            If one of them would be empty.
        """
        first = round(fraction * len(self))
        if not 0 < first < len(self):
            raise ValueError(f"fraction = {fraction} of {len(self)} trajectories leaves one side empty; change it, or cut() first.")
        order = np.random.default_rng(seed).permutation(len(self))
        return self[np.sort(order[:first])], self[np.sort(order[first:])]

    def to_frame(self):
        """A pandas table: trajectory, time in s, then one column a channel."""
        import pandas

        names = self.state_names + self.input_names
        frame = pandas.DataFrame(np.hstack([np.concatenate(self._states), np.concatenate(self._inputs)]), columns=list(names))
        frame.insert(0, "time", np.concatenate([np.arange(k) * self.dt for k in self.lengths]))
        frame.insert(0, "trajectory", np.repeat(np.arange(len(self)), self.lengths))
        return frame

    def to_xarray(self):
        """An ``xarray.Dataset``: one variable a channel along ``sample``, trajectories one behind the other.

        ``row_size`` holds the number of samples of each trajectory (CF conventions, contiguous ragged array).
        """
        import xarray

        frame = self.to_frame()
        variables = {
            "time": ("sample", frame["time"].to_numpy(), {"units": "s", "long_name": "time since the trajectory's start"}),
            "row_size": ("trajectory", self.lengths, {"sample_dimension": "sample", "long_name": "samples of each trajectory"}),
        }
        roles = (("state", self.state_names, self.state_units), ("input", self.input_names, self.input_units))
        for role, names, units in roles:
            for position, (name, unit) in enumerate(zip(names, units)):
                variables[name] = ("sample", frame[name].to_numpy(), {"units": unit, "role": role, "position": position})
        own = {"Conventions": "CF-1.11", "featureType": "trajectory", "format": _FORMAT, "sampling_time": self.dt}
        return xarray.Dataset(variables, attrs={**{k: _plain(v) for k, v in self.attributes.items()}, **own})

    def write(self, path):
        """Write to ``path``, a NetCDF-4 file (.nc) that xarray, MATLAB's ncread and ncdump open. Same content, same bytes.

        Raises
        ------
        ValueError
            If the suffix is not ``.nc``.
        """
        path = _netcdf_path(path)
        with replacing(path) as temporary:
            self.to_xarray().to_netcdf(temporary, engine="h5netcdf")

    @classmethod
    def read(cls, path):
        """Read a file that `write` has written.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not a NetCDF-4 file or not a recording.
        """
        import xarray

        path = _netcdf_path(path)
        if not path.is_file():
            raise FileNotFoundError(f"{path} does not exist; `make all` makes the project's own recordings.")
        try:
            with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
                return cls._from_xarray(dataset.load())
        except (OSError, KeyError, AttributeError, TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"{path} cannot be read as a recording ({error}); make it again with Recording.write.") from error

    @classmethod
    def _from_xarray(cls, dataset):
        if dataset.attrs.get("format") != _FORMAT:
            raise ValueError(f"its attribute 'format' is {dataset.attrs.get('format')!r}, not {_FORMAT!r}")
        ends = np.cumsum(dataset["row_size"].to_numpy())
        if ends[-1] != dataset.sizes["sample"]:
            raise ValueError(f"row_size sums to {ends[-1]} but there are {dataset.sizes['sample']} samples")
        parts = {}
        for role in ("state", "input"):
            chosen = [name for name, variable in dataset.data_vars.items() if variable.attrs.get("role") == role]
            chosen.sort(key=lambda name: dataset[name].attrs["position"])
            columns = [dataset[name].to_numpy() for name in chosen]
            table = np.column_stack(columns) if columns else np.empty((ends[-1], 0))
            parts[role] = np.split(table, ends[:-1]), chosen, [dataset[name].attrs["units"] for name in chosen]
        (states, state_names, state_units), (inputs, input_names, input_units) = parts["state"], parts["input"]
        own = ("Conventions", "featureType", "format", "sampling_time")
        return cls(
            states,
            inputs,
            float(dataset.attrs["sampling_time"]),
            state_names=state_names,
            input_names=input_names,
            state_units=state_units,
            input_units=input_units,
            attributes={k: v.tolist() if isinstance(v, (np.ndarray, np.generic)) else v for k, v in dataset.attrs.items() if k not in own},
        )

    def _with(self, states, inputs, **labels):
        """A recording of other data with this one's labels; the data are known to be sound, so nothing is checked again."""
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__, _states=states, _inputs=inputs, attributes=dict(self.attributes))
        new.__dict__.update({name: tuple(value) for name, value in labels.items()})
        if not states:
            raise ValueError("no trajectory is left; choose at least one.")
        return new


def versions():
    """Versions that decide the numbers of a recording or a model, for its attributes."""
    import platform

    import scipy

    import tras

    return {"tras": tras.__version__, "python": platform.python_version(), "numpy": np.__version__, "scipy": scipy.__version__}


def _trajectories(name, values):
    """A list of float arrays (samples_i, channels)."""
    if isinstance(values, np.ndarray) and values.ndim == 2:
        raise ValueError(f"{name} has shape {values.shape}; give (trajectories, samples, channels), for one trajectory a list of it.")
    try:
        arrays = [np.asarray(value, dtype=float) for value in values]
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} cannot be read as numbers ({error}); give arrays of shape (samples, channels).") from error
    for i, array in enumerate(arrays):
        if array.ndim != 2:
            raise ValueError(f"{name}: trajectory {i} has shape {array.shape}; give (samples, channels).")
        if len(array) == 0:
            raise ValueError(f"{name}: trajectory {i} has no samples; leave it out.")
        if array.shape[1] != arrays[0].shape[1]:
            raise ValueError(f"{name}: trajectory {i} has {array.shape[1]} channels but the first has {arrays[0].shape[1]}.")
    return arrays


def _labels(role, letter, trajectories, names, units):
    count = trajectories[0].shape[1]
    names = tuple(names) if names is not None else tuple(f"{letter}{i + 1}" for i in range(count))
    units = tuple(units) if units is not None else ("",) * count
    for kind, labels in (("names", names), ("units", units)):
        if len(labels) != count:
            raise ValueError(f"{role}_{kind} has {len(labels)} entries {labels} but there are {count} {role} channels.")
    if len(set(names)) != count:
        raise ValueError(f"{role}_names {names} repeat a name; every channel needs its own.")
    return names, units


def _check_finite(names, trajectories):
    for i, array in enumerate(trajectories):
        if not np.isfinite(array).all():
            sample, channel = np.argwhere(~np.isfinite(array))[0]
            raise ValueError(
                f"channel {names[channel]!r} is {array[sample, channel]} in trajectory {i} at sample {sample}; "
                "repair it or cut the trajectory there."
            )


def _together(trajectories):
    lengths = {len(array) for array in trajectories}
    return np.stack(trajectories) if len(lengths) == 1 else list(trajectories)


def _columns(kind, names, wanted):
    if wanted is None:
        return list(range(len(names)))
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(f"{kind}: there is no channel {missing[0]!r}; there are {', '.join(names) or 'none'}.")
    return [names.index(name) for name in wanted]


def _plain(value):
    """``value`` as something that a NetCDF attribute can hold."""
    if isinstance(value, (bool, np.bool_)):
        return int(value)
    return list(value) if isinstance(value, tuple) else value


def _netcdf_path(path):
    path = Path(path)
    if path.suffix != ".nc":
        raise ValueError(f"path {path} ends in {path.suffix!r}; recordings are NetCDF-4 files, use the ending .nc.")
    return path
