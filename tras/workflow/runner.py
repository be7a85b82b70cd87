"""Run one notebook with checked parameters, and leave either a complete result or none.

    python -m tras.workflow.runner NOTEBOOK EXECUTED [--params FILE.yaml] [--set name=value ...] [--outputs PATH ...]

A parameter whose name or type the notebook's `parameters` cell does not know is an error (`tras.workflow.parameters`).

The executed notebook appears under its final name as the very last act of a successful run, so that make can take it as
its stamp. Beside it, `EXECUTED.json` says what ran: parameters, revision, versions, machine, checksums of the outputs;
and each output has its own such file beside it (`tras.workflow.provenance`).
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
import time
from pathlib import Path

from tras.workflow import provenance
from tras.workflow.files import replacing
from tras.workflow.parameters import ParameterError, check_parameters, notebook_defaults, parse_settings, read_params

KERNEL = "python3"
# The same bits whoever starts the run: sums depend on the number of BLAS threads. A value that is set outside counts.
PINNED = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}


class RunError(RuntimeError):
    """The notebook ran and did not do what it should. ``name`` and ``words`` are those of a cell's error, if any."""

    name = words = ""


class Interrupted(KeyboardInterrupt):
    """SIGINT or SIGTERM; the argument is its number."""

    received = False  # the kernel manager asks here whether to wait for the kernel's farewell


# --- the run ----------------------------------------------------------------------------------------------------------


def run_notebook(notebook, executed, parameters=None, outputs=()):
    """Execute a notebook; its executed copy appears under its final name only if everything went well.

    Parameters
    ----------
    notebook, executed : str or Path
        The source and where the executed copy goes.
    parameters : dict, optional
        Name -> value, already checked: they replace the defaults.
    outputs : sequence of str or Path
        Files that the notebook must write.

    Returns
    -------
    float
        Seconds taken.

    Raises
    ------
    RunError
        When a cell fails, the kernel dies or an output is not written. The notebook up to there is kept as
        `*.failed.ipynb`.
    """
    notebook, executed, outputs = Path(notebook), Path(executed), [Path(output) for output in outputs]
    running, failed, record = (executed.with_suffix(end) for end in (".running.ipynb", ".failed.ipynb", ".json"))
    sidecars = [provenance.beside(output) for output in outputs]
    for folder in {path.parent for path in (executed, *outputs)}:
        folder.mkdir(parents=True, exist_ok=True)
    for leftover in (executed, record, running, failed, *sidecars, *_temporaries([record, *outputs, *sidecars])):
        leftover.unlink(missing_ok=True)
    start, started = time.time(), datetime.datetime.now(datetime.timezone.utc)
    try:
        _execute(notebook, running, parameters or {})
        _check_outputs(outputs, start, notebook)
        seconds = time.time() - start
        entry = provenance.record(
            notebook, {**notebook_defaults(notebook), **(parameters or {})}, outputs, started, seconds
        )
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


def _execute(notebook, running, parameters):
    """Papermill, with its failures as one RunError."""
    for name, value in PINNED.items():
        os.environ.setdefault(name, value)
    sys.modules.setdefault("rfc3987_syntax", None)  # optional, not needed, 1.1 s of imports
    import papermill
    from jupyter_client import AsyncKernelManager
    from jupyter_client.kernelspec import NoSuchKernel
    from nbclient.exceptions import CellTimeoutError, DeadKernelError

    guards = []

    class Manager(AsyncKernelManager):
        transport_encryption = "auto"  # else ipykernel 7.3 and later warn at every start
        shutdown_wait_time = 1.0  # s, instead of 3.4; one kernel in fifteen never answers the farewell

        async def _async_post_start_kernel(self, **options):
            await super()._async_post_start_kernel(**options)
            guards.append(_guard(self.provisioner.pgid))

        async def _async_interrupt_kernel(self):
            """No interrupt as part of the farewell: the kernel, idle or about to be killed, would only log an error."""
            if not self.shutting_down:
                await super()._async_interrupt_kernel()

        async def shutdown_kernel(self, now=False, restart=False):
            """Kill the kernel after an interrupt: asked politely in the middle of a cell, it would print tracebacks."""
            await super().shutdown_kernel(now=now or Interrupted.received, restart=restart)

    try:
        papermill.execute_notebook(
            notebook,
            running,
            parameters,
            kernel_name=KERNEL,
            progress_bar=sys.stderr.isatty(),
            cwd=notebook.resolve().parent,  # as JupyterLab has it
            kernel_manager_class=Manager,
        )
        for guard in guards:
            guard.stdin.write(b"done\n")
    except papermill.PapermillExecutionError as error:
        cell = "\n".join(f"    {line}" for line in error.source.splitlines())
        failed = RunError(
            f"{notebook.stem} failed in cell [{error.exec_count}]: {error.ename}: {error.evalue}\nThe cell:\n{cell}"
        )
        failed.name, failed.words = error.ename, error.evalue
        raise failed from None
    except (DeadKernelError, CellTimeoutError) as error:
        raise RunError(
            f"{notebook.stem}: the kernel ended in the middle of a cell ({error}); was the memory enough?"
        ) from None
    except NoSuchKernel:
        raise RunError(
            f"{notebook.stem}: this Python has no kernel `{KERNEL}`: run `make setup` and use .venv."
        ) from None
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
    """What a killed run has left of `tras.workflow.files.replacing`: a dot, the name, a dot, eight random characters."""
    return [
        path
        for final in finals
        for path in final.parent.glob(f".{glob.escape(final.stem)}.????????{glob.escape(final.suffix)}")
    ]


# --- the command line -------------------------------------------------------------------------------------------------


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


def main(arguments=None):
    """Command line; returns the exit code: 0, 1 (the run failed), 2 (the call was wrong), 130 or 143 (interrupted)."""
    parser = argparse.ArgumentParser(
        prog="python -m tras.workflow.runner", description="Run one notebook with checked parameters."
    )
    parser.add_argument("notebook", type=Path)
    parser.add_argument("executed", type=Path, help="where the executed notebook goes")
    parser.add_argument("--params", type=Path, metavar="FILE.yaml", help="parameters, one section per notebook")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="one parameter more; wins over the file"
    )
    parser.add_argument("--outputs", nargs="*", default=[], metavar="PATH", help="files that the run must write")
    options = parser.parse_args(arguments)
    try:
        with interruptible():
            defaults = notebook_defaults(options.notebook)
            section = read_params(options.params, options.notebook) if options.params else {}
            parameters = check_parameters(section, defaults, f"{options.params}, section {options.notebook.stem}")
            parameters.update(
                check_parameters(parse_settings(options.set), defaults, f"--set for {options.notebook.stem}")
            )
            seconds = run_notebook(options.notebook, options.executed, parameters, options.outputs)
        print(f"{options.notebook.stem}  {seconds:.1f} s", flush=True)
        return 0
    except ParameterError as error:
        print(error, file=sys.stderr)
        return 2
    except RunError as error:
        print(error, file=sys.stderr)
        return 1
    except OSError as error:
        problem = f"{error.filename}: {error.strerror}" if error.filename else error
        print(
            f"{options.notebook.stem}: {problem}; nothing was left under the name {options.executed}.", file=sys.stderr
        )
        return 1
    except Interrupted as interrupt:
        number = interrupt.args[0]
        print(
            f"{options.notebook.stem} was interrupted; nothing was left under the name {options.executed}.",
            file=sys.stderr,
        )
        return 128 + number


if __name__ == "__main__":
    sys.exit(main())
