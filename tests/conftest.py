"""Shared recordings, made once: the real pipeline at a small size."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

import tras

ROOT = Path(__file__).parent.parent
SLOW = {"cluster", "checkout", "browser"}  # fixtures that take seconds

# Names, units, attributes and file names that try to become code, or something else than they seem, where they are
# written: C, MATLAB, Python, LaTeX, Markdown, HTML, YAML, shells, make, terminals. "PWNED" is what they would do.
HOSTILE = [
    "<script>alert(1)<\\script>", "$\\frac{", "_a\nb", "&amp; \" onload='x'", "ü" * 60 + "\x07",
    "*\\\n/ #error PWNED", "*/\n#error PWNED\n/*", "*/ #error PWNED /*", "/*", "*/*/", "ends in a star *",
    "ends in a backslash \\", "*??/\n/\n#error PWNED", "ends in a trigraph ??/", "????/", "\\\r\n#error PWNED",
    "%{", "%}\nerror PWNED\n%{", "...\nerror('PWNED')", "'); error('PWNED'); ('", '"\n#include "PWNED',
    "#{\nerror PWNED\n#}", "\nraise SystemExit('PWNED')", '"""\nPWNED\n"""', "\rraise SystemExit('PWNED')",
    "\x85#error PWNED", "\u2028#error PWNED", "\u2029#error PWNED", "\x0b#error PWNED", "\x0c#error PWNED",
    "\\input{PWNED}", "\\end{aligned}\\write18{touch PWNED}", "^^M\\input{PWNED}", "100 % of {", "$x$ & y \\\\ z",
    "$(touch PWNED)", "`touch PWNED`", "'; touch PWNED; '", "\n\ttouch PWNED", "$(shell touch PWNED)", "$a$$b", "#c",
    "; touch PWNED;", "a | b > PWNED", "-rf", "--help", "=cmd|' -c calc'!A0", "%s %n {0.__class__} {name}",
    "!!python!object!apply:os.system ['touch PWNED']", "a: b\n- c", "&a [*a, *a]", "- # x", "null", "yes", "~", "1e3",
    "](javascript:PWNED)", "[x](y) ![z](PWNED)", "<!-- -->", "]]>", "# heading\n## heading", "| a | b |", "***",
    "user\u202egpj.exe", "\u2066a\u2069b", "zero\u200bwidth\u2060\ufeff", "soft\u00adhyphen", "\u3164\uffa0\u115f",
    "tag\U000e0041\U000e0100", "\u200f\u061c", "\x1b]0;title\x07\x1b[2J", "\x08\x08\x7f", "\x9b31m", "\ufffe\uffff",
    "שלום", "e\u0301\u0302\u0303", "µ°Ω", "while", "exp", "3 a", "π", "  blanks  ", "\t", "é" * 300,
]  # fmt: skip
LONE_SURROGATES = ["\ud800", "pitch\udc80", "\udfff\ud800"]


FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


def matrices(rows, columns):
    """Arrays (rows, columns) of any finite numbers."""
    size = rows * columns
    return st.lists(FINITE, min_size=size, max_size=size).map(lambda values: np.array(values).reshape(rows, columns))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if SLOW.intersection(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def parameters():
    return tras.PlantParameters()


@pytest.fixture(scope="session")
def experiment(parameters):
    """100 s of closed loop, both kinds of input, cut into 5 s trajectories."""
    reference = tras.multisine(100, 0.01, [0.5, 1.2], [1.0, 2.5], np.random.default_rng(1))
    return tras.simulate_closed_loop(reference, 0.01, parameters).cut(501)


@pytest.fixture(scope="session")
def torques(experiment):
    """The same with the torques as inputs."""
    return experiment.select(inputs=["u_phi", "u_psi"])


@pytest.fixture(scope="session")
def mechanical(torques):
    """A model of it that is nearly exact."""
    return tras.KoopmanModel(tras.Mechanical(), regularization=None).fit(torques)


@pytest.fixture(scope="session")
def true_plant(parameters):
    """The rig's own equations in place of a model."""
    from tras.control.predictors import plant

    return plant(parameters, 0.01)


@pytest.fixture(scope="session")
def cluster():
    """Two workers of Dask, processes of one thread. They ask a killed neighbour for its data for 5 s, not for 30."""
    import dask
    from distributed import LocalCluster

    with dask.config.set({"distributed.comm.timeouts.connect": "5s"}):
        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, processes=True)
    with cluster:
        yield cluster


@pytest.fixture(scope="module")
def browser():
    """Debian's chromium, driven by Playwright, or a skip. (Not per session: Playwright holds the event loop.)"""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs Playwright, which environment.txt has: make setup"
    )
    chromium = shutil.which("chromium")
    if not chromium:
        pytest.skip("needs the browser chromium: apt-get install chromium")
    with playwright.sync_playwright() as started:
        launched = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"] if os.geteuid() == 0 else [])
        yield launched
        launched.close()


def linear_system(A, B, dt, *, trajectories=10, samples=60, seed=0):
    """An exact recording of dx/dt = A x + B u with held random inputs: (Recording, Ad, Bd)."""
    from scipy.linalg import expm

    A, B = np.atleast_2d(A).astype(float), np.atleast_2d(B).astype(float)
    n, m = B.shape
    whole = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    Ad, Bd = whole[:n, :n], whole[:n, n:]
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, (trajectories, samples, m))
    x = np.empty((trajectories, samples, n))
    x[:, 0] = rng.uniform(-1, 1, (trajectories, n))
    for k in range(samples - 1):
        x[:, k + 1] = x[:, k] @ Ad.T + u[:, k] @ Bd.T
    return tras.Recording(x, u, dt), Ad, Bd


def ode_recording(field, dt, *, n, m=0, trajectories=40, samples=21, size=1.0, seed=0):
    """Trajectories of dx/dt = field(x, u) from random states under held random inputs, by DOP853 at tight tolerance."""
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(seed)
    x = np.empty((trajectories, samples, n))
    x[:, 0] = rng.uniform(-size, size, (trajectories, n))
    u = rng.uniform(-1, 1, (trajectories, samples, m))
    for i in range(trajectories):
        for k in range(samples - 1):
            held = u[i, k]
            flow = solve_ivp(
                lambda t, s, held=held: field(s, held), (0, dt), x[i, k], method="DOP853", rtol=1e-12, atol=1e-13
            )
            x[i, k + 1] = flow.y[:, -1]
    return tras.Recording(x, u, dt)


def for_make():
    """The environment without what a make around the tests says to those that the tests start."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}


def make_files(folder):
    """What make needs besides packages and notebooks, copied into a folder."""
    for name in ("Makefile", "pyproject.toml", "environment.txt", "environment-build.txt"):
        shutil.copy(ROOT / name, folder)


def checkout_in(folder, *names, commands=()):
    """A copy of the checkout's folders of these names with this environment, in which commands of a page have run."""
    if not list((ROOT / ".venv").glob(".ready-*")):
        pytest.skip("make setup has not run")
    make_files(folder)
    for name in names:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / ".venv").symlink_to(ROOT / ".venv")
    for command in commands:
        words = ["bash", "-e", "-c", command]
        done = subprocess.run(words, cwd=folder, env=for_make(), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return folder


def code_blocks(page, language):
    """The blocks of a language in a page of Markdown."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)


def visible_texts(figure):
    """Draw a figure; return the renderer and all texts that show, without the ticks beyond the ends of an axis."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    hidden = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = axis.get_major_ticks() + axis.get_minor_ticks()
            hidden |= {
                t for tick in ticks if not (axes.axison and low <= tick.get_loc() <= high) for t in tick.findobj(Text)
            }
    texts = [t for t in figure.findobj(Text) if t not in hidden and t.get_visible() and t.get_text().strip()]
    return canvas.get_renderer(), texts


def at(index, value):
    """A change of one number of an array."""

    def change(array):
        array = array.astype(float)
        array.flat[index] = value
        return array

    return change
