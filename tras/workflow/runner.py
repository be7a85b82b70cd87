"""Run one notebook with checked parameters, and leave either a complete result or none.

    python -m tras.workflow.runner NOTEBOOK EXECUTED [--params FILE.yaml] [--set name=value ...] [--outputs PATH ...]

The executed notebook appears under its final name as the very last act of a successful run, so that make can take it as
its stamp. `EXECUTED.json` beside it says what ran, and so does a file beside each output (`tras.workflow.provenance`).
"""

import argparse
import contextlib
import datetime
import glob
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tras.workflow import environment, provenance
from tras.workflow.arguments import extra
from tras.workflow.files import project_root, replacing, require_writable
from tras.workflow.parameters import ParameterError, check_parameters, notebook_defaults, parse_settings, read_params

KERNEL = "python3"  # the name that executed notebooks carry


class RunError(RuntimeError):
    """The notebook ran and did not do what it should. ``name`` and ``words`` are those of a cell's error, if any."""

    name = words = ""


class Interrupted(KeyboardInterrupt):
    """SIGINT or SIGTERM; the argument is its number."""

    received = False  # the kernel manager asks here whether to wait for the kernel's farewell


def run_notebook(
    notebook: str | Path, executed: str | Path, parameters: dict | None = None, outputs=(), cwd=None
) -> float:
    """Execute a notebook; its executed copy appears under its final name only if everything went well.

    Parameters
    ----------
    notebook, executed : str or Path
        The source and where the executed copy goes.
    parameters : dict, optional
        Name -> value, already checked: they replace the defaults.
    outputs : sequence of str or Path
        Files that the notebook must write.
    cwd : str or Path, optional
        The folder that it runs in. Default: its own folder, as JupyterLab has it.

    Returns
    -------
    float
        Seconds.

    Raises
    ------
    RunError
        When a cell fails, the kernel dies or an output is not written; `*.failed.ipynb` is the notebook up to there.
    """
    notebook, executed, outputs = Path(notebook), Path(executed), [Path(output) for output in outputs]
    running, failed, record = (executed.with_suffix(end) for end in (".running.ipynb", ".failed.ipynb", ".json"))
    sidecars = [provenance.beside(output) for output in outputs]
    for folder in dict.fromkeys(path.parent for path in (executed, *outputs, *sidecars)):
        require_writable(folder)
    for leftover in (executed, record, running, failed, *sidecars, *_temporaries([record, *outputs, *sidecars])):
        leftover.unlink(missing_ok=True)
    start, started = time.time(), datetime.datetime.now(datetime.UTC)
    _require_this_package(notebook)
    try:
        _execute(notebook, running, parameters or {}, cwd or notebook.resolve().parent)
        _check_outputs(outputs, start, notebook)
        seconds = time.time() - start
        parameters = notebook_defaults(notebook) | (parameters or {})
        entry = provenance.record(notebook, parameters, outputs, started, seconds)
        provenance.write_beside(entry)
        with replacing(record) as temporary:
            temporary.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
        os.replace(running, executed)
        return seconds
    except RunError as error:
        if running.exists():
            os.replace(running, failed)
            error.args = (f"{error}\nThe notebook as far as it came: {failed}",)
        raise
    except BaseException:
        running.unlink(missing_ok=True)
        raise


def _require_this_package(notebook):
    """A notebook of one checkout is not run with the package of another one."""
    try:
        root = project_root(notebook.parent)
    except FileNotFoundError:
        return
    if (root / "tras").resolve() != environment.PACKAGE.resolve():
        problem = f"the notebook is of the checkout {root}, but this is the tras of {environment.PACKAGE.parent}"
        raise RunError(f"{notebook.stem}: {problem}: run it with {root}/.venv/bin/python, in {root}.")


def _execute(notebook, running, parameters, cwd):
    """Papermill, with its failures as one RunError."""
    os.environ.update({name: value for name, value in environment.PINNED.items() if name not in os.environ})
    sys.modules.setdefault("rfc3987_syntax", None)  # optional, not needed, 1.1 s of imports
    with extra("notebooks", "running a notebook"):
        import papermill
        from ipykernel.kernelspec import get_kernel_dict
        from jupyter_client import AsyncKernelManager
        from jupyter_client.kernelspec import KernelSpec
        from nbclient.exceptions import CellTimeoutError, DeadKernelError

    guards = []
    # IPython would put the folder that it runs in, which may hold a numpy.py, before the installed packages.
    spec = KernelSpec(**get_kernel_dict(["--InteractiveShellApp.ignore_cwd=True"]))
    with tempfile.TemporaryDirectory(prefix="tras-kernel-", ignore_cleanup_errors=True) as folder:
        surroundings = environment.of_a_kernel(folder)
        if other := environment.other_package(surroundings, cwd):
            problem = f"a kernel would import tras from {other}, not from {environment.PACKAGE}"
            raise RunError(f"{notebook.stem}: {problem}: remove that one from this Python, or use another Python.")

        class Manager(AsyncKernelManager):
            kernel_spec = spec  # this interpreter's, whatever kernels there are besides
            transport_encryption = "auto"  # else ipykernel 7.3 and later warn at every start
            shutdown_wait_time = 1.0  # s, instead of 3.4; one kernel in fifteen never answers the farewell

            async def _async_pre_start_kernel(self, **options):
                self.connection_file = os.path.join(folder, "kernel.json")
                return await super()._async_pre_start_kernel(**options | {"env": surroundings})

            async def _async_post_start_kernel(self, **options):
                await super()._async_post_start_kernel(**options)
                guards.append(_guard(self.provisioner.pgid))

            async def _async_interrupt_kernel(self):
                """No interrupt as part of the farewell: the idle or dying kernel would only log an error."""
                if not self.shutting_down:
                    await super()._async_interrupt_kernel()

            async def shutdown_kernel(self, now=False, restart=False):
                """Kill the kernel after an interrupt: asked politely in a cell, it would print tracebacks."""
                await super().shutdown_kernel(now=now or Interrupted.received, restart=restart)

        try:
            how = {"kernel_name": KERNEL, "kernel_manager_class": Manager, "progress_bar": sys.stderr.isatty()}
            papermill.execute_notebook(notebook, running, parameters, cwd=cwd, **how)
            for guard in guards:
                guard.stdin.write(b"done\n")
        except papermill.PapermillExecutionError as error:
            cell = "\n".join(f"    {line}" for line in error.source.splitlines())
            problem = f"{notebook.stem} failed in cell [{error.exec_count}]: {error.ename}: {error.evalue}"
            failure = RunError(f"{problem}\nThe cell:\n{cell}")
            failure.name, failure.words = error.ename, error.evalue
            raise failure from None
        except (DeadKernelError, CellTimeoutError) as error:
            problem = f"the kernel ended in the middle of a cell ({error}); was the memory enough?"
            raise RunError(f"{notebook.stem}: {problem}") from None
        finally:
            for guard in guards:
                guard.communicate()


def _guard(group):
    """A process that ends the kernel and its workers when we are gone or give up: killed outright, we could not.

    The kernel would notice within a second, in which it might write; its idle workers would stay for five minutes.
    """
    command = ["sh", "-c", 'read -r line || kill -s KILL -- "-$1"', "sh", str(group)]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def _check_outputs(outputs, start, notebook):
    slack = 0.05  # s; a file's time comes from a coarser clock than ours
    for output in outputs:
        if not output.exists() or output.stat().st_mtime < start - slack:
            problem = "is not there" if not output.exists() else "is still the one from before"
            remedy = "let the notebook write it or drop it from make's list"
            raise RunError(f"{notebook.stem} ran to its end, but {output} {problem}: {remedy}.")


def _temporaries(finals):
    """What a killed run has left of `replacing`: a dot, the name, a dot, eight random characters."""
    patterns = {path: f".{glob.escape(path.stem)}.????????{glob.escape(path.suffix)}" for path in finals}
    return [temporary for path, pattern in patterns.items() for temporary in path.parent.glob(pattern)]


# --- the command line ---


def _interrupt(number, _frame):
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)  # one is enough: the kernel is being ended
    Interrupted.received = True
    raise Interrupted(number)


@contextlib.contextmanager
def interruptible():
    """SIGINT and SIGTERM are `Interrupted` inside, so that kernels are ended and nothing is left."""
    Interrupted.received = False
    handlers = {each: signal.signal(each, _interrupt) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code: 0, 1 (the run failed), 2 (the call was wrong), 130 or 143 (interrupted)."""
    purpose = "Run one notebook with checked parameters."
    parser = argparse.ArgumentParser(prog="python -m tras.workflow.runner", description=purpose)
    parser.add_argument("notebook", type=Path)
    parser.add_argument("executed", type=Path, help="where the executed notebook goes")
    parser.add_argument("--params", type=Path, metavar="FILE.yaml", help="parameters, one section per notebook")
    one_more = "one parameter more; wins over the file"
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=one_more)
    parser.add_argument("--outputs", nargs="*", default=[], metavar="PATH", help="files that the run must write")
    options = parser.parse_args(arguments)
    name, nothing = options.notebook.stem, f"nothing was left under the name {options.executed}."
    try:
        with interruptible():
            defaults = notebook_defaults(options.notebook)
            section = read_params(options.params, options.notebook) if options.params else {}
            parameters = check_parameters(section, defaults, f"{options.params}, section {name}")
            parameters |= check_parameters(parse_settings(options.set), defaults, f"--set for {name}")
            print(f"{name} begins", flush=True)
            seconds = run_notebook(options.notebook, options.executed, parameters, options.outputs)
        print(f"{name}  {seconds:.1f} s", flush=True)
        return 0
    except ParameterError as error:
        problem, code = error, 2
    except RunError as error:
        problem, code = error, 1
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else error.strerror or error
        problem, code = f"{name}: {reason}; {nothing}", 1
    except Interrupted as interrupt:
        problem, code = f"{name} was interrupted; {nothing}", 128 + interrupt.args[0]
    print(problem, file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
