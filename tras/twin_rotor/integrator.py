"""Butcher's Runge-Kutta method of order 6 with seven stages, written out for a number of states and inputs.

J. C. Butcher, J. Austral. Math. Soc. 4 (1964), p. 192. The method is data; `butcher` makes straight-line Python of it,
because a loop over four floats takes twice as long as the same arithmetic in one line for each of them.
"""

import functools
from collections.abc import Callable

# Stages 2 to 7: the factor of the sum, and the sum of the earlier stages' derivatives. Then the step itself.
_STAGES = (
    ("h / 3", "{1}"),
    ("2 * h / 3", "{2}"),
    ("h / 12", "{1} + 4 * {2} - {3}"),
    ("h / 16", "18 * {2} - {1} - 3 * {3} - 6 * {4}"),
    ("h / 8", "9 * {2} - 3 * {3} - 6 * {4} + 4 * {5}"),
    ("h / 44", "9 * {1} - 36 * {2} + 63 * {3} + 72 * {4} - 64 * {6}"),
)
_STEP = ("h / 120", "11 * ({1} + {7}) + 81 * ({3} + {4}) - 32 * ({5} + {6})")


@functools.lru_cache
def butcher(axes: int, others: int, inputs: int) -> Callable:
    """``step(rates, x, u, k, h) -> x``, one step of ``h`` seconds, for floats or arrays.

    Parameters
    ----------
    axes : int
        Pairs of a position and its velocity, which come first in ``x``: the velocity is the position's derivative.
    others : int
        Further states, after them.
    inputs : int
        Number of inputs, which are held over the step.

    Returns
    -------
    callable
        ``rates(*x, *u)`` gives the derivatives of velocities and further states; ``k`` is its value at ``x``.

    Examples
    --------
    >>> import math
    >>> fall = butcher(1, 0, 1)  # height and speed, gravity as the input
    >>> rates = lambda height, speed, gravity: (-gravity,)
    >>> fall(rates, (5.0, 0.0), (10.0,), (-10.0,), 1.0)
    (0.0, -10.0)
    """
    states = range(2 * axes + others)
    derived = [i for i in states if i % 2 or i >= 2 * axes]  # what `rates` gives
    held = [f"u{j}" for j in range(inputs)]

    def stage(s, factor, total):
        """Lines of stage ``s``: the states, each from the derivatives of the earlier stages."""
        at = [f"x{i}_{s} = x{i}_1 + a * ({total.format(*_slopes(i, axes))})" for i in states]
        return [f"a = {factor}", *at]

    lines = [f"{_row('x{}_1', states)} = x", f"[{_row('{}', held)}] = u", f"[{_row('k{}_1', derived)}] = k"]
    for s, (factor, total) in enumerate(_STAGES, 2):
        arguments = ", ".join([*(f"x{i}_{s}" for i in states), *held])
        lines += [*stage(s, factor, total), f"[{_row(f'k{{}}_{s}', derived)}] = rates({arguments})"]
    lines += [*stage(8, *_STEP), f"return {_row('x{}_8', states)}"]
    scope = {}
    exec("def step(rates, x, u, k, h):\n    " + "\n    ".join(lines), scope)
    return scope["step"]


def _slopes(i, axes):
    """Names of the derivative of state ``i`` at stages 1 to 7, behind one that no formula uses."""
    position = i < 2 * axes and i % 2 == 0
    return ["", *(f"x{i + 1}_{s}" if position else f"k{i}_{s}" for s in range(1, 8))]


def _row(form, numbers):
    return "".join(form.format(i) + ", " for i in numbers).rstrip()
