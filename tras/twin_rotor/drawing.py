"""The twin rotor in space: where its parts are, and how to draw them.

The sign convention of the project
----------------------------------
PHI is PITCH and PSI is YAW. The origin is the pivot, where the pitch axis crosses the yaw axis; z points up.

* phi = 0: the beam is level. **phi > 0 lifts the main rotor**, whose height is ``+l_m sin(phi)``; the tail rotor is at
  ``-l_t sin(phi)`` and the two counterweights at ``-l_cw cos(phi)``. The potential energy is therefore

      V = g [(m_m l_m - m_t l_t) sin(phi) - 2 m_cw l_cw cos(phi)],    dV/dphi = G_c cos(phi) + G_s sin(phi).

  The main rotor's side is the heavier one, so the rig rests nose down, at phi = -atan(G_c / G_s) = -0.491 rad.
* psi > 0 turns the beam counter-clockwise as seen from above.

Beam coordinates (a, b, c) turn with the rig: a points along the beam towards the main rotor, b along the pitch axis, c
upwards at right angles to both. The rotors' masses lie in the plane b = 0, the counterweights at b = +-0.061 m, which
only adds a constant 2 m_cw b^2 to the yaw inertia. Only l_m, l_t and l_cw enter the dynamics.
"""

import numpy as np
import pandas as pd
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from scipy.spatial import ConvexHull

from tras.workflow import arguments

# Solid part -> (colour, smooth?). Smooth parts are round, without edges along their sides. The rotors differ in grey.
SOLIDS = {
    name: (colour, smooth)
    for colour, smooth, names in (
        ("#d9d9d9", True, "base"),
        ("#c4c4c4", True, "pillar"),
        ("#c4c4c4", False, "fork left_ear right_ear"),
        ("#8c8c8c", True, "hub left_axle right_axle left_stub right_stub"),
        ("#e8dfc8", False, "main_arm tail_arm left_lever right_lever"),
        ("#6f6f6f", True, "left_weight right_weight"),
        ("#8c8c8c", True, "main_motor tail_motor"),
        ("#7fb8dc", True, "main_rotor"),
        ("#f0b86e", True, "tail_rotor"),
        ("#0b3c5d", False, "main_blades"),
        ("#7a3d00", False, "tail_blades"),
    )
    for name in names.split()
}
STATIC = ("base", "pillar")  # neither angle moves these parts: an overlaid second rig need not repeat them
ROTORS = ("main_rotor", "tail_rotor")  # the discs that the blades sweep, drawn translucent
MASSES = ("main_mass", "tail_mass", "left_weight_mass", "right_weight_mass")

FIGURE_POSE = (0.36, 0.60)  # pitch and yaw, rad, that show every part of the rig
CAMERA = (np.radians(-26.0), np.radians(20.0))  # azimuth and elevation of the viewer, rad
LIGHT = np.array([0.25, -0.45, 0.86])  # direction towards the light, a unit vector to two digits

_PILLAR_TOP, _BASE_TOP = -0.09, -0.33  # heights, m
_ROUND = 40  # corners of a circle


def rig_geometry(phi: float, psi: float, *, l_m=0.202, l_t=0.216, l_cw=0.25) -> pd.DataFrame:
    """Pose the rig.

    Parameters
    ----------
    phi : float
        PITCH in rad, positive with the main rotor up.
    psi : float
        YAW in rad, positive counter-clockwise as seen from above.
    l_m, l_t, l_cw : float
        Distances in m from the pivot to the main rotor, the tail rotor and the counterweights.

    Returns
    -------
    pandas.DataFrame
        Columns ``part`` (name), ``point`` (number within the part), ``x``, ``y``, ``z`` in m. Solid parts (`SOLIDS`)
        are prisms: the first half of their points is one end face, the second half the opposite one. `MASSES` are
        single points. The rest are lines: axes, reference lines and arcs of both angles, torques and thrusts, the last
        four in their positive direction.

    Raises
    ------
    ValueError
        If an angle is not finite, or a length is not positive.
    """
    for name, value in {"phi": phi, "psi": psi}.items():
        arguments.number(name, value, give="a finite angle in rad")
    for name, value in {"l_m": l_m, "l_t": l_t, "l_cw": l_cw}.items():
        arguments.number(name, value, 0, ends=False, give="a positive length in m")
    parts = {
        "base": _cylinder((0, 0, _BASE_TOP - 0.02), (0, 0, _BASE_TOP), 0.17, corners=72),
        "pillar": _cylinder((0, 0, _BASE_TOP), (0, 0, _PILLAR_TOP), 0.013),
    }
    parts |= {name: _pose(points, 0.0, psi) for name, points in _yawing_parts().items()}
    parts |= {name: _pose(points, phi, psi) for name, points in _beam_parts(l_m, l_t, l_cw).items()}
    parts |= _angle_lines(phi, psi, l_m) | _torque_lines(phi, psi, l_m, l_t)

    # Rounding to a picometre keeps noise like cos(pi/2) = 6e-17 and "-0" out of the tables.
    lengths = [len(points) for points in parts.values()]
    positions = np.round(np.concatenate(list(parts.values())), 12) + 0.0
    names = np.repeat(np.array(list(parts), dtype=object), lengths)
    numbers = np.concatenate([np.arange(length) for length in lengths])
    return pd.DataFrame({"part": names, "point": numbers, **dict(zip("xyz", positions.T))})


def project(points, camera=CAMERA) -> np.ndarray:
    """Points (..., 3) in m, as seen from far away: right, up and towards the viewer; ``camera`` as for `draw_rig`."""
    return np.asarray(points, dtype=float) @ view_axes(camera).T


def part_points(geometry: pd.DataFrame, part: str) -> np.ndarray:
    """Return the points of one part of a geometry table, (points, 3) in m."""
    rows = geometry.loc[geometry["part"] == part, ["x", "y", "z"]]
    if rows.empty:
        raise ValueError(f"The geometry has no part {part!r}; it has {', '.join(geometry['part'].unique())}.")
    return rows.to_numpy()


def draw_rig(
    axes, geometry, *, camera=CAMERA, parts=None, alpha=1.0, linewidth=0.6, edgecolor="black", colours=None, zorder=2.0
) -> list[PolyCollection]:
    """Draw the solid parts of a posed rig in ordinary two-dimensional axes, from back to front.

    For an animation, draw the static parts once (``parts=STATIC``), then remove the returned artists and draw again for
    each frame (20 ms). A prediction beside the truth is a second call with a small ``alpha`` and a lower ``zorder``.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        With equal aspect; its unit is the metre in the projected picture.
    geometry : pandas.DataFrame
        From `rig_geometry`.
    camera : tuple of float
        Azimuth and elevation of the viewer in rad.
    parts : iterable of str, optional
        Names from `SOLIDS`; all by default.
    alpha : float
        Opacity; 1 is solid.
    linewidth, edgecolor : float, colour
        Of the outlines, in points.
    colours : dict, optional
        Part -> colour, in place of those of `SOLIDS`.
    zorder : float
        Level of the rig among other artists.

    Returns
    -------
    [matplotlib.collections.PolyCollection]
        All faces, the farthest first.
    """
    names = [name for name in SOLIDS if parts is None or name in set(parts)]
    table = geometry[geometry["part"].isin(names)]
    solids = {name: rows[["x", "y", "z"]].to_numpy() for name, rows in table.groupby("part", sort=False)}
    outlines, fills, widths = [], [], []
    for name in back_to_front(solids, camera):
        colour, smooth = SOLIDS[name]
        opacity = alpha * (0.55 if name in ROTORS else 1.0)
        for outline, fill, width in _visible_faces(solids[name], smooth, (colours or {}).get(name, colour), camera):
            outlines.append(outline)
            fills.append((*fill, opacity))
            widths.append(width * linewidth)
    edges = {"edgecolors": (*to_rgb(edgecolor), alpha), "linewidths": widths, "joinstyle": "round"}
    return [axes.add_collection(PolyCollection(outlines, facecolors=fills, zorder=zorder, **edges))]


# ---------------------------------------------------------------------------------------------------------- parts


def _yawing_parts():
    """The fork that carries the pitch axis, in beam coordinates at level beam: it follows yaw alone."""
    parts = {"fork": _box((-0.012, 0.012), (-0.036, 0.036), (_PILLAR_TOP, _PILLAR_TOP + 0.012))}
    for side, sign in (("left", 1), ("right", -1)):
        parts[f"{side}_ear"] = _box((-0.012, 0.012), sorted((sign * 0.028, sign * 0.036)), (_PILLAR_TOP + 0.012, 0.014))
    return parts


def _beam_parts(l_m, l_t, l_cw):
    """Everything that pitches with the beam, in beam coordinates."""
    disc = 0.038  # the rotor discs lie this far off the beam's centre line
    parts = {
        "hub": _cylinder((0, -0.016, 0), (0, 0.016, 0), 0.018),
        "main_arm": _box((0.018, l_m - 0.013), (-0.006, 0.006), (-0.006, 0.006)),
        "tail_arm": _box((-l_t + 0.013, -0.018), (-0.006, 0.006), (-0.006, 0.006)),
        "main_motor": _cylinder((l_m, 0, -0.026), (l_m, 0, disc - 0.003), 0.013),
        "tail_motor": _cylinder((-l_t, 0.022, 0), (-l_t, -disc + 0.003, 0), 0.013),
        "main_rotor": _cylinder((l_m, 0, disc - 0.003), (l_m, 0, disc), 0.085, corners=72),
        "tail_rotor": _cylinder((-l_t, -disc + 0.003, 0), (-l_t, -disc, 0), 0.062, corners=72),
        "main_blades": _propeller((l_m, 0, disc), (0, 0, 1), 0.08),
        "tail_blades": _propeller((-l_t, -disc, 0), (0, -1, 0), 0.057),
    }
    for side, sign in (("left", 1), ("right", -1)):
        parts[f"{side}_axle"] = _cylinder((0, sign * 0.016, 0), (0, sign * 0.028, 0), 0.006)
        parts[f"{side}_stub"] = _cylinder((0, sign * 0.036, 0), (0, sign * 0.045, 0), 0.006)
        parts[f"{side}_lever"] = _box((-0.005, 0.005), sorted((sign * 0.045, sign * 0.051)), (-l_cw - 0.01, 0.012))
        parts[f"{side}_weight"] = _cylinder((0, sign * 0.051, -l_cw), (0, sign * 0.071, -l_cw), 0.024)
    masses = [(l_m, 0, 0), (-l_t, 0, 0), (0, 0.061, -l_cw), (0, -0.061, -l_cw)]
    return parts | {name: np.array([point], dtype=float) for name, point in zip(MASSES, masses)}


def _angle_lines(phi, psi, l_m):
    """Axes, and each angle as an arc from its zero line to the beam: phi in the beam's plane, psi on the base plate."""
    floor = _BASE_TOP
    reach = l_m + 0.08  # beyond the rotor, where there is room
    return {
        "yaw_axis": np.array([[0, 0, 0.03], [0, 0, 0.2]]),
        "pitch_axis": _pose([[0, -0.24, 0], [0, -0.051, 0], [0, 0.051, 0], [0, 0.10, 0]], 0.0, psi),
        "beam_line": _pose([[l_m + 0.013, 0, 0], [reach + 0.015, 0, 0]], phi, psi),
        "phi_zero": _pose([[0.018, 0, 0], [reach + 0.015, 0, 0]], 0.0, psi),
        "phi_arc": _pose(_circle((0, 0, 0), (1, 0, 0), (0, 0, 1), reach, np.linspace(0.0, phi, 33)), 0.0, psi),
        "psi_zero": np.array([[0, 0, floor], [0.16, 0, floor]]),
        "psi_beam": _pose([[0, 0, floor], [0.16, 0, floor]], 0.0, psi),
        "psi_arc": _circle((0, 0, floor), (1, 0, 0), (0, 1, 0), 0.1, np.linspace(0.0, psi, 33)),
    }


def _torque_lines(phi, psi, l_m, l_t):
    """The torques as arcs about their axes and the thrusts that cause them, all in their positive direction."""
    sweep = np.radians(np.linspace(-60.0, 200.0, 66))
    return {
        # From a towards c: the direction in which the main rotor rises.
        "u_phi": _pose(_circle((0, -0.135, 0), (1, 0, 0), (0, 0, 1), 0.038, sweep), 0.0, psi),
        "u_psi": _circle((0, 0, 0.15), (1, 0, 0), (0, 1, 0), 0.045, np.radians(np.linspace(-190.0, 90.0, 66))),
        "main_thrust": _pose([[l_m, 0, 0.04], [l_m, 0, 0.04 + 0.1]], phi, psi),
        # A force along -b at a = -l_t has the moment +l_t about the vertical: it turns psi forwards.
        "tail_thrust": _pose([[-l_t, -0.04, 0], [-l_t, -0.04 - 0.1, 0]], phi, psi),
    }


# ---------------------------------------------------------------------------------------------------------- shapes


def _pose(points, phi, psi):
    """Beam coordinates (..., 3) to x, y, z: pitch lifts +a, then yaw turns about z."""
    a, b, c = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    ahead = a * np.cos(phi) - c * np.sin(phi)
    up = a * np.sin(phi) + c * np.cos(phi)
    return np.stack([ahead * np.cos(psi) - b * np.sin(psi), ahead * np.sin(psi) + b * np.cos(psi), up], axis=-1)


def _circle(centre, first, second, radius, angles):
    """Points (angles, 3) of an arc from the direction `first` towards `second`, both of unit length."""
    return np.asarray(centre) + radius * (np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second))


def _plane(axis):
    """Two unit vectors that span the plane across an axis parallel to one of the coordinate axes."""
    k = int(np.argmax(np.abs(axis)))
    return np.eye(3)[(k + 1) % 3], np.eye(3)[(k + 2) % 3]


def _cylinder(start, end, radius, corners=_ROUND):
    start, end = np.array(start, dtype=float), np.array(end, dtype=float)
    angles = 2 * np.pi * np.arange(corners) / corners
    return np.concatenate([_circle(p, *_plane(end - start), radius, angles) for p in (start, end)])


def _box(a, b, c):
    corners = [(a[0], b[0]), (a[1], b[0]), (a[1], b[1]), (a[0], b[1])]
    return np.array([(*ab, height) for height in c for ab in corners])


def _propeller(centre, axis, radius):
    """Two slim blades, one convex lozenge 1 mm thick, on the rotor's disc."""
    along, across = _plane(axis)
    turn = np.radians(35.0)  # across the line of sight from the usual camera, so the blades are visible
    along, across = along * np.cos(turn) + across * np.sin(turn), across * np.cos(turn) - along * np.sin(turn)
    half = np.array([(-1, 0.05), (-1, -0.05), (-0.1, -0.09), (0.1, -0.09)])
    outline = np.concatenate([half, -half])
    flat = np.asarray(centre) + radius * (outline[:, :1] * along + outline[:, 1:] * across)
    return np.concatenate([flat, flat + 0.001 * np.asarray(axis)])


# --------------------------------------------------------------------------------------------------------- drawing


def view_axes(camera) -> np.ndarray:
    """Unit vectors right, up and towards the viewer as rows, (3, 3)."""
    azimuth, elevation = camera
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return np.stack([right, np.cross(towards, right), towards])


def face_planes(solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces of a right prism: outward unit normals (faces, 3) and offsets (faces,) with ``normal @ point = offset``.

    The first and second half of the points are the first two faces; face 2 + i lies between the corners i - 1 and i.
    """
    first, second = np.split(solid, 2)
    axis = second[0] - first[0]
    normals = np.concatenate([[-axis, axis], np.cross(first - np.roll(first, 1, axis=0), axis)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, np.concatenate([first[:1], second[:1], first]))
    inwards = normals @ solid.mean(axis=0) > offsets
    return np.where(inwards[:, None], -normals, normals), np.where(inwards, -offsets, offsets)


def _corners(solid, face):
    """Corners of one face of a prism, numbered as in `face_planes`."""
    first, second = np.split(solid, 2)
    if face < 2:
        return (first, second)[face]
    i = face - 2
    return np.stack([first[i - 1], first[i], second[i], second[i - 1]])


def back_to_front(solids: dict[str, np.ndarray], camera) -> list[str]:
    """Sort convex solids so that each comes after all that it hides.

    A face of one of them mostly separates two of them, and the one on the viewer's side of that face is in front. Where
    no face decides, or three solids form a cycle, the distance of the centres does.
    """
    names = list(solids)
    right, up, towards = view_axes(camera)
    points = np.concatenate([solids[name] for name in names])
    flat = points @ np.stack([right, up], axis=1)
    starts = np.cumsum([0] + [len(solids[name]) for name in names[:-1]])
    over = np.zeros((len(names), len(names)), dtype=bool)  # [i, j]: i is on the viewer's side of a separating face
    apart = np.zeros_like(over)  # the outlines do not overlap in the picture
    for i, name in enumerate(names):
        normals, offsets = face_planes(solids[name])
        beyond = np.minimum.reduceat(points @ normals.T - offsets, starts) > -1e-9  # (solids, faces)
        facing = normals @ towards
        over[:, i] |= (beyond & (facing > 1e-9)).any(axis=1)
        over[i, :] |= (beyond & (facing < -1e-9)).any(axis=1)
        sides = ConvexHull(flat[starts[i] : starts[i] + len(solids[name])]).equations
        apart[i] = (np.minimum.reduceat(flat @ sides[:, :2].T + sides[:, 2], starts) > -1e-9).any(axis=1)
    # A pair that is ordered both ways does not overlap in the picture either.
    after = over & ~over.T & ~(apart | apart.T)

    remaining = sorted(range(len(names)), key=lambda i: solids[names[i]].mean(axis=0) @ towards)
    order = []
    while remaining:
        free = [i for i in remaining if not after[i, remaining].any()]
        order.append((free or remaining)[0])
        remaining.remove(order[-1])
    return [names[i] for i in order]


def _visible_faces(solid, smooth, colour, camera):
    """Yield (outline (corners, 2), red-green-blue fill, relative line width) for what the viewer sees of a prism."""
    view = view_axes(camera)
    normals, _ = face_planes(solid)
    faces = np.flatnonzero(normals @ view[2] > 1e-9)
    if smooth:
        flat = (solid @ view.T)[:, :2]
        yield flat[ConvexHull(flat).vertices], _shade(colour, 0.35), 1.0
        faces = faces[faces < 2]
    for face in faces:
        yield (_corners(solid, face) @ view.T)[:, :2], _shade(colour, normals[face] @ LIGHT), 0.6 if smooth else 0.8


def _shade(colour, brightness):
    """Mix a colour with white where the light falls, with black elsewhere; -1 <= brightness <= 1."""
    rgb = np.array(to_rgb(colour))
    amount = 0.5 * brightness
    return tuple(rgb + (1 - rgb) * amount if amount > 0 else rgb * (1 + 0.6 * amount))
