"""How much a control loop bears, of the model linearised where it rests: gain, phase and delay at the inputs."""

import copy
from typing import NamedTuple

import numpy as np

_STEP = 1e-5  # of central differences, in scaled channels
_DELAYS = 50  # samples of further delay that are tried


class Margins(NamedTuple):
    """What changes at the inputs the linearised loop bears: `margins`.

    Attributes
    ----------
    radius : float
        Spectral radius of the closed loop; stable below 1.
    disk : (m,) ndarray
        Disk margin of each input, the others as they are: 0 is on the edge, 2 the best there is.
    disk_of_all : float
        Of all inputs changed at once, each in its own way: at least this, by the largest singular value.
    delay : int
        Samples of further delay, in all inputs, that leave it stable; 50 stands for that or more.
    """

    radius: float
    disk: np.ndarray
    disk_of_all: float
    delay: int


def gain_and_phase(disk: float) -> tuple[float, float, float]:
    """Factors between which a gain may lie, and degrees that a phase may lag, for a disk margin.

    P. Seiler, A. Packard and P. Gahinet, *An introduction to disk margins*, IEEE Control Syst. 40 (5), 2020, 78.

    Examples
    --------
    >>> low, high, phase = gain_and_phase(1.0)
    >>> round(low, 3), round(high, 3), round(phase, 1)
    (0.333, 3.0, 53.1)
    """
    high = (2 + disk) / (2 - disk) if disk < 2 else np.inf
    return max(2 - disk, 0.0) / (2 + disk), high, float(np.degrees(2 * np.arctan(disk / 2)))


def margins(
    controller, z: np.ndarray, of_inputs: np.ndarray, of_states: np.ndarray, reference: np.ndarray
) -> Margins | None:
    """Of the loop of a controller, with its observer, and its own model, linearised where they have come to rest.

    Parameters
    ----------
    controller : LQR or MPC
        Its ``u`` is the input at rest. It is not changed.
    z, of_inputs, of_states : (n',), (m,) and (n',) ndarray
        State there, and what disturbs inputs and states, as the controller has them, in scaled channels.
    reference : (p,) ndarray
        What the followed states should be, in scaled channels.

    Returns
    -------
    Margins or None
        None where a limit is active, so that the loop is open.
    """
    c = controller.channels
    u = (controller.u - c.u_offset) / c.u_scale
    low, high = ((controller.limits - c.u_offset[:, None]) / c.u_scale[:, None]).T
    if ((u <= low + 1e-6) | (u >= high - 1e-6)).any():
        return None
    _, slopes = controller.predictor.advance_with_slopes(z[:, None], (u + of_inputs)[:, None])
    plant = slopes[0][:, : len(z)], slopes[0][:, len(z) :]
    law = _law(controller, plant, _gains(controller, (z, of_inputs, of_states, u), reference))
    if not all(np.isfinite(part).all() for part in (*plant, *law)):
        return None
    disk, of_all = _disk_margins(plant, law)
    delays = range(1, _DELAYS + 1)
    unstable = (k for k in delays if _radius(plant, law, k) >= 1)
    radius = _radius(plant, law, 0)
    return Margins(radius, disk, of_all, next(unstable, _DELAYS + 1) - 1 if radius < 1 else 0)


def _gains(controller, point, reference):
    """Derivatives of the input by state, disturbances of inputs and states, and last input, by central differences."""
    sizes, point = np.cumsum([len(part) for part in point[:-1]]), np.concatenate(point)
    columns = []
    for step in _STEP * np.eye(len(point)):
        change = [_input(controller, *np.split(moved, sizes), reference) for moved in (point + step, point - step)]
        columns.append((change[0] - change[1]) / (2 * _STEP))
    return np.split(np.transpose(columns), sizes, axis=1)


def _input(controller, z, of_inputs, of_states, u, reference):
    """The next input from there; the controller is as it was."""
    trial, c = copy.copy(controller), controller.channels
    trial.u = u * c.u_scale + c.u_offset
    return trial._inputs(z, of_inputs, of_states, np.atleast_2d(reference))


def _law(controller, plant, gains):
    """(A, B, C, D) of the controller, linear in small deviations, from the model's state to the input."""
    by_state, by_input_disturbance, by_state_disturbance, by_input = gains
    m, observer = len(by_input), controller.observer
    if observer is None:
        return by_input, by_state, by_input, by_state
    (A, B), count = plant, len(plant[0])
    on_inputs, on_states = observer.on_inputs, observer.on_states
    d = on_inputs.shape[1]
    by_disturbance = by_input_disturbance @ on_inputs + by_state_disturbance @ on_states
    F = np.block([[A, B @ on_inputs + on_states], [np.zeros((d, count)), np.eye(d)]])
    G = np.vstack([B, np.zeros((d, m))])
    trial, rows, c = copy.copy(observer), observer.rows, controller.channels
    trial._predict((controller.u - c.u_offset) / c.u_scale)
    P = trial.covariance
    gain = np.linalg.solve(P[np.ix_(rows, rows)] + observer.R, P[rows]).T
    measured = np.eye(count + d)[rows]
    keep = np.eye(count + d) - gain @ measured
    by_estimate = np.hstack([by_state, by_disturbance])
    last = by_estimate @ keep
    A_c = np.block([[keep @ F, keep @ G], [last @ F, last @ G + by_input]])
    B_c = np.vstack([gain @ measured[:, :count], by_estimate @ gain @ measured[:, :count]])
    return A_c, B_c, A_c[-m:], B_c[-m:]


def _disk_margins(plant, law):
    """Of each input alone, and of all at once, with a disk that is as large for more as for less gain."""
    (A, B), (A_c, B_c, C_c, D_c) = plant, law
    one, m = np.eye(B.shape[1]), B.shape[1]
    alone, together = np.zeros(m), 0.0
    for angle in np.geomspace(1e-4, 1, 600) * np.pi:
        w = np.exp(1j * angle)
        response = np.linalg.solve(w * np.eye(len(A)) - A, B.astype(complex))
        control = D_c + C_c @ np.linalg.solve(w * np.eye(len(A_c)) - A_c, B_c.astype(complex))
        balanced = np.linalg.inv(one - control @ response) - one / 2  # (S - T) / 2
        alone = np.maximum(alone, np.abs(np.diagonal(balanced)))
        together = max(together, np.linalg.norm(balanced, 2))
    return 1 / alone, 1 / together


def _radius(plant, law, delay):
    """Spectral radius of the closed loop with ``delay`` samples more between controller and plant."""
    (A, B), (A_c, B_c, C_c, D_c) = plant, law
    n, k, m = len(A), len(A_c), B.shape[1]
    if not delay:
        return float(np.abs(np.linalg.eigvals(np.block([[A + B @ D_c, B @ C_c], [B_c, A_c]]))).max())
    line = np.eye(m * delay, k=-m)  # the newest input first
    first = np.zeros((m * delay, n + k))
    first[:m] = np.hstack([D_c, C_c])
    acting = np.zeros((n, m * delay))
    acting[:, -m:] = B
    rows = [[A, np.zeros((n, k)), acting], [B_c, A_c, np.zeros((k, m * delay))]]
    whole = np.vstack([*(np.hstack(row) for row in rows), np.hstack([first, line])])
    return float(np.abs(np.linalg.eigvals(whole)).max())
