"""`Recording`: measured or simulated trajectories with names, units and sampling time (paper, "Data collection")."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tras.io import content
from tras.workflow.arguments import short

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Trajectories = ArrayLike | Sequence[ArrayLike]
_TEST = "test_trajectories"  # attribute: numbers of the trajectories that are for the test


class Recording:
    """Trajectories of one system, all with the same channels and sampling time; lengths may differ.

    The numbers are copied once, here, and cannot be changed afterwards. A trajectory of a single sample is allowed (it
    has no snapshot pair).

    Parameters
    ----------
    states : (trajectories, samples, n) array_like or list of (samples_i, n)
        What is to be predicted; ``n >= 1``.
    inputs : (trajectories, samples, m) array_like or list of (samples_i, m), optional
        What acts from outside, sample ``k`` held from sample ``k`` to ``k + 1``. None for an autonomous system.
    dt : float
        Sampling time in s.
    state_names, input_names : sequence of str, optional
        Default ``x1, x2, ...`` and ``u1, u2, ...``. Not "trajectory", "time", "sample", "row_size", and without "/".
    state_units, input_units : sequence of str, optional
        Default: unknown, ``""``.
    attributes : dict, optional
        Name -> what a reader needs to know about the origin: anything that JSON holds (None, bool, finite numbers,
        strings, lists and dicts of them). Tuples and numpy's arrays and numbers become lists and numbers.

    Raises
    ------
    ValueError
        On wrong shapes, unequal lengths of states and inputs, empty trajectories, masked values, NaN or infinity (with
        the place), names that repeat, are reserved or do not match in number, a sampling time that is not positive,
        attributes that JSON cannot hold.

    Examples
    --------
    >>> import numpy as np
    >>> r = Recording(np.zeros((1, 50001, 4)), np.zeros((1, 50001, 2)), 0.01).cut(501)
    >>> len(r), r.states.shape, r.pairs
    (100, (100, 501, 4), 50000)
    """

    # No attribute `shape` here: with __len__ and __getitem__ alone scikit-learn splits a recording by trajectories.

    def __init__(
        self,
        states: Trajectories,
        inputs: Trajectories | None = None,
        dt: float | None = None,
        *,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        state_units: Sequence[str] | None = None,
        input_units: Sequence[str] | None = None,
        attributes: dict | None = None,
    ):
        self.dt = _number(dt)
        if not (math.isfinite(self.dt) and self.dt > 0):
            raise ValueError(f"dt is {dt!r}; give the sampling time in s, a positive number.")
        self._states = content.float_arrays("states", states)
        if not self._states:
            raise ValueError("states holds no trajectory; give at least one.")
        if inputs is None:
            inputs = [np.empty((len(x), 0)) for x in self._states]
        self._inputs = content.float_arrays("inputs", inputs)
        if len(self._inputs) != len(self._states):
            raise ValueError(
                f"inputs has {len(self._inputs)} trajectories but states has {len(self._states)}; give one for one."
            )
        for i, (x, u) in enumerate(zip(self._states, self._inputs)):
            if len(x) != len(u):
                raise ValueError(
                    f"trajectory {i} has {len(x)} samples of states but {len(u)} of inputs; they must be equal."
                )
        if self._states[0].shape[1] == 0:
            raise ValueError("states has no channel; give at least one.")
        self.state_names, self.state_units = content.names_and_units(
            "state", "x", self._states, state_names, state_units
        )
        self.input_names, self.input_units = content.names_and_units(
            "input", "u", self._inputs, input_names, input_units
        )
        shared = set(self.state_names) & set(self.input_names)
        if shared:
            raise ValueError(f"the name {sorted(shared)[0]!r} stands for a state and for an input; rename one.")
        for names, trajectories in ((self.state_names, self._states), (self.input_names, self._inputs)):
            content.require_finite(names, trajectories)
        self.attributes = content.json_attributes(attributes or {})

    @property
    def states(self) -> np.ndarray | list[np.ndarray]:
        """(trajectories, samples, n) array; a list of (samples_i, n) when the lengths differ."""
        return _together(self._states)

    @property
    def inputs(self) -> np.ndarray | list[np.ndarray]:
        """(trajectories, samples, m) array; a list of (samples_i, m) when the lengths differ."""
        return _together(self._inputs)

    @property
    def lengths(self) -> np.ndarray:
        """Samples of each trajectory, (trajectories,)."""
        return np.array([len(x) for x in self._states])

    @property
    def pairs(self) -> int:
        """Number of snapshot pairs (12): one less than samples in each trajectory."""
        return int(np.sum(self.lengths - 1))

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.state_names)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.input_names)

    def __len__(self) -> int:
        return len(self._states)

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Trajectories as pairs ``(states (samples, n), inputs (samples, m))``, no copies."""
        return zip(self._states, self._inputs)

    def __getitem__(self, index: int | slice | Sequence[int] | Sequence[bool] | np.ndarray) -> "Recording":
        """A recording of the trajectory or trajectories at an integer, slice, list of integers or boolean mask."""
        numbers = np.atleast_1d(np.arange(len(self))[index])
        return self._of([self._states[i] for i in numbers], [self._inputs[i] for i in numbers], numbers.tolist())

    def __repr__(self):
        lengths = self.lengths
        samples = f"{lengths[0]}" if np.all(lengths == lengths[0]) else f"{lengths.min()} to {lengths.max()}"
        channels = f"states {_listed(self.state_names)}; inputs {_listed(self.input_names) or 'none'}"
        return f"Recording: {len(self)} trajectories of {samples} samples at {self.dt:g} s; {channels}"

    def _repr_html_(self):
        from tras.display import html

        return html.recording_html(self)

    def plot(self, channels: Sequence[str] | None = None, ax: "Axes | Sequence[Axes] | None" = None) -> "Figure":
        """Channels over time, one below the other; trajectories one after the other, their beginnings marked.

        Parameters
        ----------
        channels : sequence of str, optional
            At most six. Default: the first states and inputs.
        ax : matplotlib Axes or sequence of them, optional
            Where to draw, one per channel. Default: a new figure.

        Raises
        ------
        ValueError
            If there is no such channel, or the axes are not as many.

        Examples
        --------
        >>> recording = Recording([[[0.0], [1.0], [0.5]]], dt=0.1, state_names=["q"], state_units=["m"])
        >>> recording.plot().axes[0].get_title(loc="left")
        'q (m)'
        """
        from tras.display import plots

        return plots.recording_figure(self, channels, ax)

    def select(self, *, states: Sequence[str] | None = None, inputs: Sequence[str] | None = None) -> "Recording":
        """The same trajectories with only the named channels, in the order given.

        Raises
        ------
        ValueError
            If a name is not among the channels.
        """
        x = _columns("states", self.state_names, states)
        u = _columns("inputs", self.input_names, inputs)
        return self.with_data(
            [a[:, x] for a in self._states],
            [a[:, u] for a in self._inputs],
            state_names=[self.state_names[i] for i in x],
            state_units=[self.state_units[i] for i in x],
            input_names=[self.input_names[i] for i in u],
            input_units=[self.input_units[i] for i in u],
        )

    def cut(self, samples: int) -> "Recording":
        """Cut every trajectory into pieces of ``samples`` samples that share their end points; a shorter rest is
        dropped.

        50001 samples give 100 pieces of 501, with all of their 50000 snapshot pairs.

        Raises
        ------
        ValueError
            If ``samples`` is not a whole number, less than 2, or no trajectory is that long.
        """
        samples = whole_number("samples", samples)
        if samples < 2 or samples > self.lengths.max():
            raise ValueError(
                f"samples = {samples}; pieces need 2 to {self.lengths.max()} samples, the longest trajectory's length."
            )
        pieces = [
            (x[k : k + samples], u[k : k + samples], i)
            for i, (x, u) in enumerate(self)
            for k in range(0, len(x) - samples + 1, samples - 1)
        ]
        return self._of(*map(list, zip(*pieces)))

    def cut_all(self, samples: int) -> "Recording":
        """As `cut`, but rests and shorter trajectories are kept with the length that they have."""
        samples = whole_number("samples", samples)
        if samples < 2:
            raise ValueError(f"samples = {samples}; pieces need 2 samples or more.")
        states, inputs, origins = [], [], []
        for i, (x, u) in enumerate(self):
            for k in range(0, max(len(x) - 1, 1), samples - 1):
                states.append(x[k : k + samples])
                inputs.append(u[k : k + samples])
                origins.append(i)
        return self._of(states, inputs, origins)

    def decimated(self, every: int, lead: int = 0) -> "Recording":
        """Every ``every``-th sample of the states, and the means of the inputs over the samples between.

        The mean of a fast input does the same work on a slow system as the input itself. With ``lead=1`` the mean is
        that of the samples up to a kept one, for models with that `lead`; otherwise of those from it on.

        Examples
        --------
        >>> recording = Recording([[[0.0], [1.0], [2.0], [3.0], [4.0]]], [[[0.0], [2.0], [4.0], [6.0], [8.0]]], 0.1)
        >>> fewer = recording.decimated(2)
        >>> fewer.states[0].ravel(), fewer.inputs[0].ravel(), fewer.dt
        (array([0., 2., 4.]), array([1., 5., 8.]), 0.2)
        """
        every = whole_number("every", every)
        if every < 1 or lead not in (0, 1):
            raise ValueError(f"every = {every}, lead = {lead!r}; give 1 sample or more, and a lead of 0 or 1.")
        if every == 1:
            return self
        states, inputs = [], []
        for x, u in self:
            states.append(x[::every])
            starts = np.arange(0, len(x), every)
            u = np.concatenate([np.repeat(u[:1], every - 1, axis=0), u])[: len(starts) * every] if lead else u
            inputs.append(np.add.reduceat(u, starts) / np.diff(starts, append=len(u))[:, None])
        new = self._of(states, inputs, range(len(self)))
        new.dt = every * self.dt
        return new

    def delayed(self, delays: int, *, inputs: bool = False) -> "Recording":
        """The states of ``delays`` earlier samples, newest first, as states beside the present ones, and the earlier
        inputs if asked.

        Trajectories become ``delays`` samples shorter. Names are ``phi[-1]``, ``phi[-2]``, ...

        Raises
        ------
        ValueError
            If a trajectory has not more than ``delays`` samples.
        """
        delays = whole_number("delays", delays)
        if delays < 0:
            raise ValueError(f"delays = {delays}; give 0 or more.")
        if delays == 0:
            return self
        if self.lengths.min() <= delays:
            i = int(np.argmin(self.lengths))
            raise ValueError(
                f"trajectory {i} has {self.lengths[i]} samples, too few for {delays} delays; "
                "leave it out or use fewer delays."
            )
        past = range(1, delays + 1)
        states, held = [], []
        for x, u in self:
            earlier = [x[delays - k : len(x) - k] for k in past] + (
                [u[delays - k : len(u) - k] for k in past] if inputs else []
            )
            states.append(np.hstack([x[delays:], *earlier]))
            held.append(u[delays:])
        names, units = list(self.state_names), list(self.state_units)
        for labels, marks in ((self.state_names, self.state_units), (self.input_names, self.input_units))[: 1 + inputs]:
            names += [f"{label}[-{k}]" for k in past for label in labels]
            units += list(marks) * delays
        return self.with_data(states, held, state_names=names, state_units=units)

    def split(self, fraction: float, seed: int) -> tuple["Recording", "Recording"]:
        """Two recordings: a random ``fraction`` of the trajectories, and the rest, each in the old order.

        Raises
        ------
        ValueError
            If one of them would be empty.
        """
        share = _number(fraction)
        first = round(share * len(self)) if math.isfinite(share) else 0
        if not 0 < first < len(self):
            raise ValueError(
                f"fraction = {fraction} of {len(self)} trajectories leaves one side empty; change it, or cut() first."
            )
        order = np.random.default_rng(seed).permutation(len(self))
        return self[np.sort(order[:first])], self[np.sort(order[first:])]

    def to_frame(self) -> "pandas.DataFrame":
        """A pandas table: trajectory, time in s, then one column per channel."""
        import pandas

        names = self.state_names + self.input_names
        frame = pandas.DataFrame(
            np.hstack([np.concatenate(self._states), np.concatenate(self._inputs)]), columns=list(names)
        )
        frame.insert(0, "time", np.concatenate([np.arange(k) * self.dt for k in self.lengths]))
        frame.insert(0, "trajectory", np.repeat(np.arange(len(self)), self.lengths))
        return frame

    def to_xarray(self) -> "xarray.Dataset":
        """An ``xarray.Dataset``: one variable per channel along ``sample``, trajectories one behind the other.

        ``row_size`` holds the number of samples of each trajectory (CF conventions, contiguous ragged array). The
        global attribute ``attributes`` holds all of this recording's attributes as JSON, from which `read` has them
        back exactly; those that are single numbers or strings stand beside it under their own names, for ncdump and
        MATLAB.
        """
        from tras.io import netcdf

        return netcdf.to_xarray(self, content.json_attributes(self.attributes))

    def write(self, path: str | Path) -> None:
        """Write to ``path``: NetCDF-4 (.nc), .csv, .parquet or MATLAB (.mat, version 7). Same content, same bytes.

        `read` has everything back, numbers to the last bit. A .nc opens in xarray, MATLAB's ncread and ncdump, a .csv
        (with a comment line above the names) in pandas and spreadsheets; .mat holds cells ``states`` and ``inputs`` of
        matrices (samples, channels).

        Raises
        ------
        ValueError
            If the suffix is none of these, or an attribute set since is none that JSON can hold.
        """
        from tras.io import formats

        formats.write(self, formats.known(path), content.json_attributes(self.attributes))

    @classmethod
    def read(
        cls,
        path: str | Path | Sequence[str | Path],
        roles: dict | str | Path | None = None,
        *,
        dt: float | None = None,
        resample: float | None = None,
        missing: str = "cut",
        tolerance: float = 0.2,
        start: float | None = None,
        end: float | None = None,
        decimate: int = 1,
        test: str | Path | Sequence[str | Path | int] | None = None,
    ) -> "Recording":
        """Read a file that `write` has written, or one of your own from a logger, a spreadsheet or MATLAB.

        Parameters
        ----------
        path : str or pathlib.Path, or a sequence of them
            .nc (written by `write`), .parquet, .mat (versions 4 to 7.3: arrays, structs, iddata, timetables, Simulink's
            logs, cell arrays of trials), or a text table: .csv, .txt, .dat, .tsv, .log, .lvm, as loggers, oscilloscopes
            and spreadsheets write them. Several files are trials if they have the same columns, else signals of one
            recording, merged by time.
        roles : dict or path of a YAML file, optional
            ``time`` and ``trial``: a column each (or null); ``states`` (or ``outputs``) and ``inputs``: lists of
            columns; ``units``: column -> unit; ``dt``: sampling time in s. Columns are called by name, or by number
            from 1. ``trial`` may be the column of time: a new trial begins where it jumps back. Roles not given are
            guessed where names (t, time; u1, torque; q, x2, theta_dot; run) or values are plain, and said in
            ``attributes["guessed"]``. Where they are not, the error is a question with a guess for every column.
        dt : float, optional
            Sampling time in s. It is taken whatever a column of time says.
        resample : float, optional
            New sampling time in s: linear for states, the last value held for inputs. Otherwise uneven times are an
            error.
        missing : {"cut", "refuse"}
            Rows with an empty, NaN or infinite value: trajectories are cut there, or it is an error. Pieces of a single
            sample are dropped.
        tolerance : float
            How far a time stamp may lie from the even grid that fits all of them best, as a fraction of the sampling
            time. Of fewer than ten stamps 0.01 at most.
        start, end : float, optional
            The part of every trial that is read, in s since its first sample.
        decimate : int
            Keep the first of every so many samples; inputs become their mean over the samples between.
        test : path, or a sequence of paths or of numbers of trials (from 1), optional
            What `tras.identify` tests by, and nothing is chosen or fitted by. Its numbers of trajectories are in
            ``attributes["test_trajectories"]``.

        Returns
        -------
        Recording
            What was guessed is in ``attributes["guessed"]``, what was cut, resampled, constant or left aside in
            ``attributes["noticed"]``; `tras.remarks` makes sentences of both.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is damaged, too large, holds what is no number (text, complex, sparse, objects), if roles are not
            plain, time goes backwards, repeats or is uneven: a `tras.io.roles.RecordingError` with path and place.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "log.csv"
        >>> _ = path.write_text("t [s];theta [rad];torque [N m]\\n0,0;0,1;2\\n0,1;0,2;2\\n0,2;0,4;1,5\\n")
        >>> recording = Recording.read(path)
        >>> recording
        Recording: 1 trajectories of 3 samples at 0.1 s; states theta; inputs torque
        >>> recording.attributes["guessed"]
        ['time is column t', 'states are theta', 'inputs are torque', 'the sampling time is 0.1 s']
        """
        from tras.io import formats, frame, sampling
        from tras.io.roles import RecordingError
        from tras.workflow.arguments import MissingExtraError

        if frame.is_frame(path):
            raise RecordingError(
                f"path is an open {type(path).__name__}; read a table with Recording.from_frame(dataframe)."
            )
        paths = [formats.known(each) for each in ([path] if isinstance(path, (str, Path)) else path)]
        if not paths:
            raise ValueError("path is an empty list; give at least one file.")
        wishes = sampling.Wishes(resample, missing, tolerance, start, end, decimate)
        test = [test] if isinstance(test, (str, Path, int)) else test
        try:
            return cls(**content.with_names(formats.read(paths, roles, dt=dt, test=test, wishes=wishes)))
        except (FileNotFoundError, MissingExtraError):
            raise
        except Exception as error:  # damaged files make the libraries below raise anything
            name = ", ".join(map(str, paths)) if len(paths) < 4 else f"{paths[0]} and {len(paths) - 1} more files"
            if paths[0].suffix == ".nc" and not str(error).startswith(name):
                raise RecordingError(
                    f"{name} cannot be read as a recording ({error}); make it again with Recording.write."
                ) from error
            what = (
                str(error)
                if isinstance(error, ValueError)
                else f"it is damaged, or not what its suffix says ({type(error).__name__}: {error})"
            )
            raise RecordingError(what if what.startswith(name) else f"{name}: {what}") from error

    @classmethod
    def from_frame(
        cls,
        dataframe: "pandas.DataFrame",
        roles: dict | str | Path | None = None,
        *,
        dt: float | None = None,
        resample: float | None = None,
        missing: str = "cut",
        tolerance: float = 0.2,
        start: float | None = None,
        end: float | None = None,
        decimate: int = 1,
        test: int | Sequence[int] | None = None,
    ) -> "Recording":
        """A recording of a pandas table, as `read` makes one of a file.

        Parameters
        ----------
        dataframe : pandas.DataFrame
            One column per channel, (samples, columns). An index of times, or one with a name, is a column, too. Units:
            ``dataframe.attrs["units"]``, a dict column -> unit, or those of ``roles``.
        roles, dt, resample, missing, tolerance, start, end, decimate
            As for `read`.
        test : int or sequence of int, optional
            Numbers of the trials, from 1, that are held back for the test.

        Raises
        ------
        ValueError
            As `read`.

        Examples
        --------
        >>> import pandas
        >>> table = pandas.DataFrame({"t": [0.0, 0.1, 0.2], "theta": [0.1, 0.2, 0.4], "torque": [2.0, 2.0, 1.5]})
        >>> Recording.from_frame(table)
        Recording: 1 trajectories of 3 samples at 0.1 s; states theta; inputs torque
        """
        from tras.io import formats, frame, sampling
        from tras.io.roles import RecordingError

        wishes = sampling.Wishes(resample, missing, tolerance, start, end, decimate)
        test = [test] if isinstance(test, int) else test
        try:
            arguments = formats.recording_of(frame.open_table(dataframe), [], roles, dt=dt, trials=test, wishes=wishes)
            return cls(**content.with_names(arguments))
        except ValueError as error:
            raise RecordingError(str(error)) from error

    def _of(self, states, inputs, origins):
        """`with_data` of trajectories that come from those with the numbers ``origins``: the test set stays one."""
        new = self.with_data(states, inputs)
        held_back = self.held_back()
        new._hold_back([i for i, origin in enumerate(origins) if origin in held_back])
        return new

    def with_data(self, states: list[np.ndarray], inputs: list[np.ndarray], **labels) -> "Recording":
        """A recording of other trajectories (lists of sound arrays) with this one's labels; nothing is checked."""
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__, _states=states, _inputs=inputs, attributes=dict(self.attributes))
        new.__dict__.update({name: tuple(value) for name, value in labels.items()})
        if not states:
            raise ValueError("no trajectory is left; choose at least one.")
        if len(states) != len(self):
            new._hold_back([])  # the numbers were those of other trajectories
        return new

    def held_back(self) -> list[int]:
        """Numbers of the trajectories that are for the test (attribute ``test_trajectories``), or []."""
        numbers = self.attributes.get(_TEST)  # a file may hold anything under this name
        return [i for i in range(len(self)) if i in numbers] if isinstance(numbers, list) else []

    def _hold_back(self, numbers):
        """State which trajectories are for the test."""
        self.attributes.pop(_TEST, None)
        if numbers:
            self.attributes[_TEST] = numbers


def join(recordings: Recording | Iterable[Recording]) -> Recording:
    """One recording of a recording, or of a sequence of recordings with the same channels and sampling time.

    Raises
    ------
    ValueError
        If they differ, or there are none.
    """
    if isinstance(recordings, Recording):
        return recordings
    try:
        several: list = list(recordings)
    except TypeError:
        several = [recordings]
    if not several or not all(isinstance(each, Recording) for each in several):
        raise ValueError(
            f"recording is {type(several[0]).__name__ if several else 'empty'}; "
            "give a tras.Recording or a sequence of them."
        )
    first = several[0]
    for i, other in enumerate(several[1:], start=1):
        require_alike(first, other, i)
    joined = first.with_data([x for each in several for x, _ in each], [u for each in several for _, u in each])
    joined._hold_back([k for r, before in _offsets(several) for k in (before + i for i in r.held_back())])
    return joined


def _offsets(recordings):
    """(recording, number of trajectories before it) of each."""
    return zip(recordings, np.cumsum([0, *map(len, recordings)]).tolist())


def require_alike(first, other, i):
    """A ValueError if recording ``i`` has other channels or another sampling time than the first."""
    for label in ("dt", "state_names", "input_names"):
        if getattr(other, label) != getattr(first, label):
            raise ValueError(
                f"recording {i} has {label} {getattr(other, label)} but the first has {getattr(first, label)}; "
                "make them alike."
            )


def _listed(names):
    """Names for one line: the first of many, and how many there are."""
    if len(names) <= 8:
        return ", ".join(map(short, names))
    return f"{', '.join(map(short, names[:6]))}, ... ({len(names)})"


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


def _number(value):
    """``value`` as a float; NaN if it is no number."""
    try:
        return math.nan if isinstance(value, (str, bytes, bool)) else float(value)
    except (TypeError, ValueError):
        return math.nan


def whole_number(name, value):
    number = _number(value)
    if not number.is_integer():
        raise ValueError(f"{name} = {value!r}; give a whole number.")
    return int(number)
