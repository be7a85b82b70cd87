"""`make sweep`: a sweep that a YAML file describes, its table and figure in a folder.

    python -m tras.sweeps.command params/sweeps/dictionaries.yaml --out build/sweep/dictionaries [--scheduler ADDRESS]

The folder gets ``table.csv``, ``error.pdf``, .svg, .png and .csv, and ``cache/``. Killed or interrupted, the same
command goes on where it was.
"""

import argparse
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import pydantic

from tras.plotting import save_figure
from tras.recording import Recording
from tras.sweeps.figures import COLUMNS, sweep_figure
from tras.sweeps.grid import DATA, MODEL
from tras.sweeps.sweep import sweep
from tras.twin_rotor.closed_loop import simulate_closed_loop
from tras.twin_rotor.excitation import PITCH_MAX_FREQUENCY, PITCH_PEAK, YAW_MAX_FREQUENCY, YAW_PEAK, multisine
from tras.workflow.arguments import did_you_mean, short
from tras.workflow.files import replacing
from tras.workflow.yaml_file import read_yaml

Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]
Names = Annotated[list[str], pydantic.Field(min_length=1)]


class DescriptionError(ValueError):
    """The YAML file does not describe a sweep."""


class _Strict(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", strict=True)


class Simulation(_Strict):
    """The simulated experiment (`tras.simulate_closed_loop` of a `tras.multisine`): s, rad/s, rad."""

    duration: Positive = 500.0
    sampling_time: Positive = 0.01
    pitch_max_frequency: Positive = PITCH_MAX_FREQUENCY
    yaw_max_frequency: Positive = YAW_MAX_FREQUENCY
    pitch_peak: Positive = PITCH_PEAK
    yaw_peak: Positive = YAW_PEAK
    max_correlation: Positive = 0.05
    seed: Annotated[int, pydantic.Field(ge=0)] = 1

    def recording(self) -> Recording:
        band, peak = [self.pitch_max_frequency, self.yaw_max_frequency], [self.pitch_peak, self.yaw_peak]
        dt, largest = self.sampling_time, self.max_correlation
        reference = multisine(self.duration, dt, band, peak, self.seed, max_correlation=largest)
        return simulate_closed_loop(reference, dt)


class Description(_Strict):
    """A sweep as YAML describes it; the fields are those of `tras.sweep`."""

    recording: Any  # path, list of paths, or {simulate: {...}}
    models: Any  # a grid, or a list of grids
    held_out: Any = None
    roles: dict | str | None = None  # of files of one's own, as for Recording.read
    states: Names | None = None
    inputs: list[str] | None = None
    window: Positive | None = None
    train_fraction: Annotated[float, pydantic.Field(gt=0, lt=1)] = 0.8

    def arguments(self) -> dict:
        """Arguments of `tras.sweep`."""
        same = {name: getattr(self, name) for name in ("states", "inputs", "window", "train_fraction")}
        judged_by = None if self.held_out is None else self._source("held_out")
        return {"recording": self._source("recording"), "grid": self.models, "held_out": judged_by, **same}

    def _source(self, name):
        value = getattr(self, name)
        if isinstance(value, dict) and list(value) == ["simulate"]:
            return _checked(Simulation, value["simulate"] or {}, f"{name}: simulate: ").recording()
        paths = value if isinstance(value, list) else [value]
        if not paths or not all(isinstance(path, str) for path in paths):
            remedy = "give the path of a file, a list of paths, or `simulate: {duration: 500.0, ...}`"
            raise DescriptionError(f"{name} is {short(repr(value), 60)}; {remedy}.")
        return paths if self.roles is None else [Recording.read(path, self.roles) for path in paths]


def read(path: str | Path) -> Description:
    """The `Description` in a YAML file.

    Raises
    ------
    ValueError
        If it cannot be read, or does not describe a sweep; the sentence begins with the file's name.
    """
    return _checked(Description, read_yaml(path, DescriptionError), f"{path}: ")


def _checked(kind, content, where):
    names = ", ".join(kind.model_fields)
    if not isinstance(content, dict):
        raise DescriptionError(
            f"{where}it holds {short(repr(content), 60)}; write one `name: value` per line, there are {names}."
        )
    try:
        return kind(**{str(name): value for name, value in content.items()})
    except pydantic.ValidationError as error:
        problem = error.errors()[0]
        name = ".".join(map(str, problem["loc"]))
        if problem["type"] == "extra_forbidden":
            raise DescriptionError(f"{where}there is no {name!r}{did_you_mean(name, kind.model_fields)}") from None
        if problem["type"] == "missing":
            raise DescriptionError(f"{where}{name} is missing; there are {names}.") from None
        reason = problem["msg"].removeprefix("Input ")
        raise DescriptionError(f"{where}{name} is {short(repr(problem['input']), 60)}; it {reason}.") from None


def write(table: pd.DataFrame, folder: Path) -> None:
    """``table.csv`` and, if there is a model, the figure; ten digits, as in all tables behind figures."""
    with replacing(folder / "table.csv") as temporary:
        table.drop(columns="model").to_csv(temporary, index=False, float_format="%.10g", lineterminator="\n")
    if table["best"].any():
        shown = table[list(COLUMNS)]
        save_figure(sweep_figure(shown), shown, folder / "error")


def summary(table: pd.DataFrame, folder: Path) -> str:
    """What came out, in a few lines."""
    models = table[table["outcome"] == "model"].sort_values("error", kind="stable")
    diverged = int((models["diverged"] > 0).sum())
    lines = [f"{len(table)} fits, {len(models)} with a model, {diverged} of these with windows that diverged"]
    varied = [name for name in (*MODEL, *DATA) if name != "dictionary" and table[name].nunique(dropna=False) > 1]
    for _, row in models.head(3).iterrows():
        options = "".join(f", {name} {_spelled(name, row[name])}" for name in varied)
        dictionary = f"{row['dictionary']}, N = {row['functions']:.0f}"
        lines.append(f"  error {row['error']:.3g} of the half-range: {dictionary}{options}")
    if models.empty:
        lines.append(f"  none has a model; the first because: {table['outcome'].iloc[0]}")
    return "\n".join([*lines, f"{folder / 'table.csv'}"])


def _spelled(name, value):
    if pd.isna(value):
        return "all" if name == "seconds" else "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns 0, 1 (no model, or data, scheduler or disk failed), 2 (a wrong call) or 130 (Ctrl-C)."""
    parser = argparse.ArgumentParser("python -m tras.sweeps.command", description="Fit every point of a grid.")
    add, addresses = parser.add_argument, "'processes' (default), 'none', or that of a Dask scheduler: tcp://host:8786"
    add("description", type=Path, help="YAML file, for example params/sweeps/dictionaries.yaml")
    add("--out", type=Path, help="folder for table, figure and cache (default: build/sweep/NAME)")
    add("--scheduler", default="processes", help=addresses)
    options = parser.parse_args(arguments)
    folder = options.out or Path("build") / "sweep" / options.description.stem
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # leave as after Ctrl-C
    try:
        scheduler = None if options.scheduler == "none" else options.scheduler
        table = sweep(**read(options.description).arguments(), scheduler=scheduler, cache=folder / "cache")
        write(table, folder)
    except KeyboardInterrupt as interrupt:
        print(str(interrupt) or "interrupted; sweep again to go on.", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, DescriptionError) else 1
    finally:
        signal.signal(signal.SIGTERM, before)
    print(summary(table, folder))
    return 0 if table["best"].any() else 1


if __name__ == "__main__":
    sys.exit(main())
