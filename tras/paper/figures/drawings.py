"""The two drawings of the paper: Fig. 1, the rig, and Fig. 2, the method as a diagram. Tables in, `Figure` out."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon

from tras.paper.figures.paper import PITCH_COLOUR, YAW_COLOUR
from tras.plotting import WIDTH, require, styled
from tras.twin_rotor.drawing import draw_rig, part_points, project

FORMULA = 8.6  # points: the smallest size whose indices (0.7 of it) still reach 6 points

# ------------------------------------------------------------------------------------------------ Fig. 1: the rig


@styled()
def rig_figure(geometry: pd.DataFrame) -> Figure:
    """Fig. 1: the twin rotor, its axes, angles and torques. phi is PITCH and psi is YAW.

    Parameters
    ----------
    geometry : pandas.DataFrame
        From `tras.twin_rotor.drawing.rig_geometry`; the labels are placed for its ``FIGURE_POSE``.
    """
    require(geometry, "geometry", ["part", "point", "x", "y", "z"])
    figure, axes = _drawing_board(width=0.80, height=0.67, low=(-0.395, -0.43))
    parts = {name: project(part_points(geometry, name))[:, :2] for name in geometry["part"].unique()}
    _rig_axes(axes, parts, near=False)
    draw_rig(axes, geometry)
    _rig_axes(axes, parts, near=True)
    _rig_arrows(axes, parts)
    _rig_names(axes, parts)
    _rig_symbols(axes, parts)
    return figure


def _rig_axes(axes, parts, near):
    """Pitch and yaw axis, dash-dotted as in engineering drawings; the rig covers the far parts, not the near one."""
    line = {"color": "black", "linewidth": 0.6, "linestyle": (0, (9, 2, 2, 2)), "zorder": 4 if near else 1}
    pitch = parts["pitch_axis"]
    for segment in [pitch[:2]] if near else [pitch[2:], parts["yaw_axis"]]:
        axes.plot(*segment.T, **line)


def _rig_arrows(axes, parts):
    """Angles from their zero line to the beam (thin), torques about their axes and the thrusts behind them (thick)."""
    thin = {"color": "black", "linewidth": 0.5, "zorder": 4}
    dashed = (0, (5, 2.5))
    for part, style in {"phi_zero": dashed, "beam_line": "-", "psi_zero": dashed, "psi_beam": "-"}.items():
        axes.plot(*parts[part].T, linestyle=style, **thin)
    by_angle = {PITCH_COLOUR: ("phi_arc", "u_phi", "main_thrust"), YAW_COLOUR: ("psi_arc", "u_psi", "tail_thrust")}
    for colour, names in by_angle.items():
        for part, width in zip(names, (0.9, 1.5, 1.5)):
            _curved_arrow(axes, parts[part], colour, width)


def _curved_arrow(axes, points, colour, width):
    """A line along points (n, 2) with a head that bends with it: tip at the last point, foot on the line."""
    length = 0.012 + 0.005 * width
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    foot = np.array([np.interp(along[-1] - length, along, column) for column in points.T])
    shaft = np.vstack([points[along < along[-1] - length], foot])
    across = 0.4 * (points[-1] - foot)[::-1] * (-1, 1)
    axes.plot(*shaft.T, color=colour, linewidth=width, linestyle="-", zorder=5, solid_capstyle="butt")
    axes.add_patch(Polygon([points[-1], foot + across, foot - across], facecolor=colour, linewidth=0, zorder=5))


def _rig_names(axes, parts):
    def name(text, text_at, *part_at, **options):
        axes.text(*text_at, text, zorder=6, **({"ha": "center", "va": "center", "fontsize": FORMULA} | options))
        for start, end in part_at:
            axes.plot(*np.transpose([start, end]), color="black", linewidth=0.45, linestyle="-", zorder=5.5)

    middle = {part: points.mean(axis=0) for part, points in parts.items()}
    arm, near, far = (middle[part] for part in ("main_arm", "right_weight", "left_weight"))
    name("main rotor, $m_m$", middle["main_rotor"] + (0.147, 0.05))
    name("tail rotor, $m_t$", middle["tail_rotor"] + (0.0, 0.083))
    name("beam", (0.052, 0.097), ((0.055, 0.083), arm + (-0.023, 0.0)))
    lines = (far + (0.06, 0.008), far + (0.025, 0.005)), (far + (0.06, -0.022), near + (0.028, 0.0))
    weights = "counterweights,\neach of mass $m_{cw}$"
    name(weights, far + (0.062, -0.004), *lines, ha="left", linespacing=1.0)
    name("pitch axis", parts["pitch_axis"][0] + (0.03, -0.02))
    name("yaw axis", parts["yaw_axis"][1] + (0.0, 0.015))
    name("thrust", parts["main_thrust"][1] + (0.045, 0.0))
    name("thrust", parts["tail_thrust"][1] + (-0.045, 0.0))
    convention = "pitch $\\phi$ is positive with the main rotor up, yaw $\\psi$ anticlockwise from above"
    name(convention, (0.005, -0.415), fontsize=7.5)


def _rig_symbols(axes, parts):
    def symbol(text, at, colour="black", size=9):
        axes.text(*at, text, color=colour, fontsize=size, ha="center", va="center", zorder=6)

    symbol(r"$\phi$", parts["phi_arc"][16] + (0.02, 0), PITCH_COLOUR, 10)
    symbol(r"$\psi$", 1.48 * parts["psi_arc"][16] - 0.48 * parts["psi_zero"][0], YAW_COLOUR, 10)
    symbol(r"$u_\phi$", parts["u_phi"][33] + (0.01, 0.035), PITCH_COLOUR, 10)
    symbol(r"$u_\psi$", parts["u_psi"][-1] + (0.03, 0), YAW_COLOUR, 10)
    symbol("$l_m$", parts["main_arm"].mean(axis=0) + (0.047, -0.018))
    symbol("$l_t$", parts["tail_arm"].mean(axis=0) + (-0.03, 0.02))
    symbol("$l_{cw}$", parts["left_lever"].mean(axis=0) + (0.03, 0.0))


# --------------------------------------------------------------------------------------------- Fig. 2: the method

_PANELS = [  # name, text, left, bottom, width, height in inches
    ("state", r"state space $\mathbb{R}^n$", 0.03, 1.78, 3.44, 0.88),
    ("lifted", r"lifted space $\mathbb{R}^N$", 0.03, 0.03, 3.44, 1.10),
]
_NODES = [  # name, text, centre x, centre y, width, height in inches
    ("snapshot pairs", r"$\{(x_k, u_k),\,(y_k, u_k)\}$", 0.69, 2.09, 1.16, 0.44),
    ("vector field", r"$\dot{x} = F(x, u)$", 2.95, 2.09, 0.90, 0.44),
    ("lifted data", r"$\Psi_x,\ \Psi_y$", 0.42, 0.59, 0.62, 0.44),
    ("Koopman matrix", r"$K = \Psi_x^{\dagger}\Psi_y$", 1.67, 0.59, 0.88, 0.44),
    ("generator", r"$A = \log(K)/T_s$", 2.95, 0.59, 0.90, 0.44),
]
_FIT = r"$A^{\mathrm{T}}\psi = (\partial\psi/\partial x)\,F,\ \ F = W\psi$"
_ARROWS = [  # start, end, text, equation, step (0: not a step), linestyle, x, y of the label in inches, alignment
    ("snapshot pairs", "vector field", "classical nonlinear\nidentification", "", 0, "--", 1.86, 2.12, "bottom"),
    ("snapshot pairs", "lifted data", "lift with\n$\\psi(x, u)$", "(13)", 1, "-", 0.55, 1.455, "left"),
    ("lifted data", "Koopman matrix", "linear\nidentification", "(14)", 2, "-", 0.98, 0.33, "top"),
    ("Koopman matrix", "generator", "principal\nlogarithm", "(15)", 3, "-", 2.305, 0.33, "top"),
    ("generator", "vector field", f"{_FIT}\nby least squares", "(18)", 3, "-", 2.82, 1.455, "right"),
]
_BOX = ["name", "text", "x", "y", "width", "height"]
_COLUMNS = ["kind", *_BOX, "start", "end", "step", "equation"]


def method_diagram() -> pd.DataFrame:
    """The diagram of the method as a table: panels, nodes and arrows with their labels.

    Returns
    -------
    pandas.DataFrame
        Columns ``kind`` ("panel", "node", "arrow"), ``name``, ``text``; ``x``, ``y`` (lower left corner of a panel,
        centre of a node, label of an arrow), ``width``, ``height`` in inches; and for arrows ``start``, ``end``
        (names of nodes), ``step`` (1 to 3, 0 for none), ``equation`` (number in the paper), ``linestyle``, ``align``.
    """
    panels = pd.DataFrame(_PANELS, columns=_BOX).assign(kind="panel")
    nodes = pd.DataFrame(_NODES, columns=_BOX).assign(kind="node")
    arrows = pd.DataFrame(_ARROWS, columns=["start", "end", "text", "equation", "step", "linestyle", "x", "y", "align"])
    arrows = arrows.assign(kind="arrow", name=arrows["start"] + " to " + arrows["end"])
    table = pd.concat([panels, nodes, arrows], ignore_index=True)
    table["step"] = table["step"].astype("Int64")
    return table[[*_COLUMNS, "linestyle", "align"]]


@styled()
def method_figure(diagram: pd.DataFrame) -> Figure:
    """Fig. 2: from data to vector field, directly (dashed) or through the lifted space, where the problem is linear.

    Parameters
    ----------
    diagram : pandas.DataFrame
        From `method_diagram`.
    """
    require(diagram, "diagram", _COLUMNS)
    figure, axes = _drawing_board(width=WIDTH, height=2.69)
    nodes = diagram[diagram["kind"] == "node"].set_index("name")
    for panel in diagram[diagram["kind"] == "panel"].itertuples():
        _draw_panel(axes, panel)
    for node in nodes.itertuples():
        _draw_node(axes, node)
    for arrow in diagram[diagram["kind"] == "arrow"].itertuples():
        _draw_arrow(axes, arrow, nodes)
    return figure


def _draw_box(axes, corner, size, rounding, **look):
    style = f"round,pad=0,rounding_size={rounding}"
    axes.add_patch(FancyBboxPatch(corner, size.width, size.height, boxstyle=style, **look))


def _draw_panel(axes, panel):
    shade = {"state": "#f3f3f3", "lifted": "#dfe9f2"}[panel.name]
    _draw_box(axes, (panel.x, panel.y), panel, 0.06, facecolor=shade, linewidth=0)
    middle, top = panel.x + panel.width / 2, panel.y + panel.height
    axes.text(middle, top - 0.06, panel.text, ha="center", va="top", fontsize=FORMULA)


def _draw_node(axes, node):
    corner = node.x - node.width / 2, node.y - node.height / 2
    _draw_box(axes, corner, node, 0.04, facecolor="white", edgecolor="black", linewidth=0.7, zorder=2)
    axes.text(node.x, node.y + 0.075, node.text, ha="center", va="center", fontsize=9, zorder=3)
    axes.text(node.x, node.y - 0.115, node.Index, ha="center", va="center", fontsize=7.5, zorder=3)


def _draw_arrow(axes, arrow, nodes):
    start, end = _ends(nodes.loc[arrow.start], nodes.loc[arrow.end])
    head = {"arrowstyle": "-|>,head_length=0.4,head_width=0.18", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 1}
    line = {"linestyle": arrow.linestyle, "color": "black", "linewidth": 1.0, "zorder": 2}
    axes.add_patch(FancyArrowPatch(start, end, **head, **line))
    level = start[1] == end[1]
    middle = ((start[0] + end[0]) / 2, start[1]) if level else (start[0], arrow.y)
    text = arrow.text if level else f"{arrow.text}  {arrow.equation}"
    sides = {"ha": "center", "va": arrow.align} if level else {"ha": arrow.align, "va": "center"}
    axes.text(arrow.x, arrow.y, text, linespacing=1.15, fontsize=FORMULA, zorder=3, **sides)
    if level and arrow.equation:
        axes.text(middle[0], middle[1] + 0.11, arrow.equation, ha="center", va="bottom", zorder=3)
    if arrow.step:
        axes.add_patch(Circle(middle, 0.075, facecolor="black", linewidth=0, zorder=4))
        axes.text(*middle, str(arrow.step), color="white", fontsize=7.5, ha="center", va="center_baseline", zorder=5)


def _ends(start, end):
    """Start and end of the arrow between two boxes: level, or straight up or down."""
    if start.y == end.y:
        side = np.sign(end.x - start.x)
        return (start.x + side * start.width / 2, start.y), (end.x - side * end.width / 2, end.y)
    side = np.sign(end.y - start.y)
    x = (start if start.width < end.width else end).x  # the middle of the narrower box
    return (x, start.y + side * start.height / 2), (x, end.y - side * end.height / 2)


def _drawing_board(width, height, low=(0.0, 0.0)):
    """A figure one column wide and its only axes, which fill it without frame: `width` by `height` in data units."""
    figure = Figure(figsize=(WIDTH, WIDTH * height / width))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set(xlim=(low[0], low[0] + width), ylim=(low[1], low[1] + height), aspect="equal")
    axes.set_autoscale_on(False)
    return figure, axes
