"""The rig in motion: the truth, a prediction or a reference as a ghost, and both angles below.

A `film` is a table of both motions; `gif` writes it to a file, always with the same bytes, which are `gif_bytes`.
"""

import io
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tras.plotting import MODEL, TRUTH, require, styled
from tras.twin_rotor.drawing import MASSES, STATIC, draw_rig, rig_geometry
from tras.workflow.files import replacing

GHOSTS = {"koopman": "Koopman model", "reference": "reference"}  # ending of its columns -> its name in the legend
GHOST = "#56B4E9"
SIZE = (4.4, 4.2)  # inches
DPI = 100
COLOURS = 40  # of the GIF's one palette


def columns(ghost: str = "koopman") -> list[str]:
    """What a film's table holds: time in s, and angles in rad of the truth and of the ghost."""
    return ["time", "phi_true", "psi_true", f"phi_{ghost}", f"psi_{ghost}"]


def film(overlay: pd.DataFrame, *, rate: float = 10.0, ghost: str = "koopman") -> pd.DataFrame:
    """The frames of an animation: the table's rows nearest to their times. NaN from where a prediction diverged.

    Parameters
    ----------
    overlay : pandas.DataFrame
        Its `columns`, for example from `tras.paper.validation.overlay`.
    rate : float
        Frames per second; the film runs in real time.
    ghost : str
        Which columns are the ghost's, one of `GHOSTS`.

    Raises
    ------
    ValueError
        If a column is missing, the truth is not finite, or ``rate`` is not positive.
    """
    require(overlay, "overlay", columns(ghost))
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"rate is {rate!r}; give frames per second, for example 10.")
    if not np.isfinite(overlay[columns(ghost)[:3]].to_numpy()).all():
        raise ValueError("overlay holds NaN or infinity in the truth or the time; leave those samples out.")
    time = overlay["time"].to_numpy()
    frames = np.arange(time[0], time[-1] + 0.5 / rate, 1 / rate)
    nearest = np.unique(np.abs(time[:, None] - frames).argmin(axis=0))
    return overlay[columns(ghost)].iloc[nearest].reset_index(drop=True)


class Scene:
    """The moving picture: it draws the static parts once; `show` draws one instant.

    Parameters
    ----------
    table : pandas.DataFrame
        From `film`.
    label : str, optional
        Name of the ghost in the legend; default that of `GHOSTS`.
    solid : str
        Name of the rig that is no ghost.
    """

    @styled()
    def __init__(self, table: pd.DataFrame, label: str | None = None, solid: str = "truth"):
        self.ghost = next((name for name in GHOSTS if f"phi_{name}" in table), next(iter(GHOSTS)))
        require(table, "table", columns(self.ghost))
        self.table, self._moving = table, []
        self.figure = Figure(figsize=SIZE, dpi=DPI)
        FigureCanvasAgg(self.figure)
        self.rig = self.figure.add_axes((0.0, 0.35, 1.0, 0.64))
        self.rig.set_axis_off()
        self.rig.set(xlim=(-0.42, 0.42), ylim=(-0.41, 0.32), aspect="equal")
        self.rig.set_autoscale_on(False)
        draw_rig(self.rig, rig_geometry(0.0, 0.0), parts=STATIC, zorder=1)
        self.angles = [self.figure.add_axes((0.095, low, 0.885, 0.1)) for low in (0.245, 0.085)]
        _angle_panel(self.angles[0], table, "psi", self.ghost, r"yaw $\psi$ (rad)")
        _angle_panel(self.angles[1], table, "phi", self.ghost, r"pitch $\phi$ (rad)")
        self.angles[0].tick_params(labelbottom=False)
        self.angles[1].set_xlabel("time (s)", labelpad=1)
        handles = [self.angles[0].plot([], [], **TRUTH)[0], self.angles[0].plot([], [], **MODEL)[0]]
        self.figure.legend(handles, [solid, label or GHOSTS[self.ghost]], loc="upper left", bbox_to_anchor=(0.01, 0.99))

    @styled()
    def show(self, frame: int) -> list:
        """Draw one instant, by its number in the table; returns the artists that moved."""
        for artist in self._moving:
            artist.remove()
        row = self.table.iloc[frame]
        self._moving = []
        angles = [float(row[f"{angle}_{self.ghost}"]) for angle in ("phi", "psi")]
        if np.isfinite(angles).all():
            ghost = rig_geometry(*angles)
            look = {"alpha": 0.35, "colours": dict.fromkeys(ghost["part"].unique(), GHOST), "edgecolor": MODEL["color"]}
            self._moving += draw_rig(self.rig, ghost, parts=_moving_parts(ghost), zorder=3, **look)
        truth = rig_geometry(float(row["phi_true"]), float(row["psi_true"]))
        self._moving += draw_rig(self.rig, truth, parts=_moving_parts(truth), zorder=2)
        for panel, angle in zip(self.angles, ("psi", "phi")):
            self._moving.append(panel.axvline(row["time"], color="0.5", linewidth=0.8, linestyle="-"))
            self._moving += panel.plot(row["time"], row[f"{angle}_true"], marker="o", color="black", zorder=5)
        return self._moving

    def pixels(self, frame: int) -> np.ndarray:
        """One instant as (height, width, 3) bytes of red, green and blue."""
        self.show(frame)
        with styled():
            self.figure.canvas.draw()
        return np.asarray(self.figure.canvas.buffer_rgba())[..., :3].copy()


def gif(table: pd.DataFrame, path: str | Path, **options) -> Path:
    """Write `gif_bytes`, whose options these are, to a file whose name ends in ``.gif``; returns its path."""
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(gif_bytes(table, **options))
    return Path(path)


def gif_bytes(
    table: pd.DataFrame, *, label: str | None = None, solid: str = "truth", rate: float = 10.0, progress=None
) -> bytes:
    """A `film` as an animated GIF in a loop; the same film gives the same bytes on the same machine.

    All frames share one palette, so that the static parts do not flicker and take no space.

    Parameters
    ----------
    table : pandas.DataFrame
        From `film`.
    label, solid : str, optional
        As for `Scene`.
    rate : float
        Frames per second, as for `film`; GIF counts hundredths of a second, so 10, 12.5, 20 and 25 are exact.
    progress : text stream, optional
        Takes a progress bar, for example ``sys.stderr``.
    """
    from PIL import Image
    from tqdm import tqdm

    scene = Scene(table, label, solid)
    numbers = tqdm(range(len(table)), desc="frames", file=progress, disable=progress is None)
    frames = [Image.fromarray(scene.pixels(k)) for k in numbers]
    sample = frames[:: max(1, len(frames) // 6)]
    sheet = Image.new("RGB", (frames[0].width, frames[0].height * len(sample)))
    for k, frame in enumerate(sample):
        sheet.paste(frame, (0, k * frame.height))
    palette = sheet.quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[colours.min(axis=1) >= 250] = 255  # pure white, not the mean of nearly white colours
    palette.putpalette(colours.ravel().tolist())
    flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    target = io.BytesIO()
    options = {"duration": round(1000 / rate), "loop": 0, "optimize": False}
    flat[0].save(target, format="GIF", save_all=True, append_images=flat[1:], **options)
    return target.getvalue()


def _angle_panel(panel, table, angle, ghost, name):
    true, predicted = table[f"{angle}_true"], table[f"{angle}_{ghost}"]
    panel.plot(table["time"], predicted, **MODEL)
    panel.plot(table["time"], true, **TRUTH, zorder=3)
    margin = max(np.ptp(true), 0.3)  # a prediction that diverges must not squeeze the truth to a line
    low, high = panel.get_ylim()
    panel.set_xlim(table["time"].iloc[0], table["time"].iloc[-1])
    panel.set_ylim(max(low, true.min() - margin), min(high, true.max() + margin))
    panel.set_ylabel(name, rotation=0, ha="left", va="bottom", labelpad=0)
    panel.yaxis.set_label_coords(0.0, 1.01)


def _moving_parts(geometry):
    return set(geometry["part"]) - set(STATIC) - set(MASSES)
