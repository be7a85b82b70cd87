"""What a build takes from the environment that it is started in: as little as it can.

A variable may put another `tras` on Python's path, a user's configuration other code into a kernel or another style
into a figure, and the number of threads decides last bits. The Makefile leaves the same variables out for what it
starts.
"""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
# The same bits whoever starts the run: sums depend on the number of BLAS threads. A value that is set outside counts.
PINNED = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
# Settings of interpreter, notebooks and figures; MPLCONFIGDIR stays: it says where Matplotlib keeps its list of fonts.
_SETTINGS = ("PYTHON", "JUPYTER", "IPYTHON", "MPLBACKEND", "MATPLOTLIB", "BASH_ENV", "PYDEVD", "DEBUGPY")


def of_a_kernel(folder: str | Path) -> dict[str, str]:
    """The environment of a kernel, from that of this process.

    Settings of interpreter, notebooks and figures are left out, and `PINNED` is in. The kernel imports this `tras`, no
    module of the folder that it runs in, and Matplotlib with its defaults. IPython's and Jupyter's own files, the
    startup files of its profile among them, are those of ``folder``.

    >>> environment = of_a_kernel("/tmp/empty")
    >>> environment["IPYTHONDIR"], environment["MATPLOTLIBRC"], "PYTHONSTARTUP" in environment
    ('/tmp/empty', '/dev/null', False)
    """
    outside = {name: value for name, value in os.environ.items() if not name.startswith(_SETTINGS)}
    pinned = {name: os.environ.get(name, value) for name, value in PINNED.items()}
    own = {f"JUPYTER_{kind}_DIR": str(folder) for kind in ("CONFIG", "DATA", "RUNTIME")} | {"IPYTHONDIR": str(folder)}
    # Not as the first of the path: ipykernel drops that if the kernel runs there.
    path = {} if _is_installed() else {"PYTHONPATH": f"{folder}{os.pathsep}{PACKAGE.parent}"}
    return outside | pinned | own | path | {"PYTHONSAFEPATH": "1", "MATPLOTLIBRC": os.devnull}


def other_package(environment: dict[str, str], folder: str | Path) -> str:
    """Where a new interpreter finds `tras` if that is not this package; else nothing.

    Parameters
    ----------
    environment : dict of str to str
        Of the interpreter.
    folder : str or Path
        That it starts in.
    """
    code = "import importlib.util as u; s = u.find_spec('tras'); print(s.origin if s else '')"
    found = subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True)
    origin = found.stdout.strip().splitlines()[-1:] or ["nowhere"]
    return "" if Path(origin[0]).parent.resolve() == PACKAGE.resolve() else origin[0]


def _is_installed():
    """Whether this package lies where every interpreter of this environment looks; its folder holds others, too."""
    return PACKAGE.parent.resolve() in {Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib")}
