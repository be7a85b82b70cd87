"""A folder of results: written together or not at all, and never over the files of others."""

import contextlib
import os
import shutil
import tempfile
from pathlib import Path, PurePosixPath

from tras.workflow.files import umask

LISTING = "contents.csv"  # what a run has written, one file per row


@contextlib.contextmanager
def written_together(folder: str | Path):
    """An empty folder to write to, whose files are moved into ``folder`` when the block ends well.

    Files that an earlier run has listed there are replaced, and removed if they are no longer made; others stay.

    Raises
    ------
    OSError
        If the folder cannot be written; it is then as it was, or, at worst, some files are new and others old.

    Examples
    --------
    >>> folder = Path(tempfile.mkdtemp()) / "results"
    >>> with written_together(folder) as stage:
    ...     _ = (stage / "a.txt").write_text("whole")
    >>> sorted(os.listdir(folder))
    ['a.txt', 'contents.csv']
    """
    import pandas as pd

    folder = Path(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield stage
        files = sorted(path.relative_to(stage).as_posix() for path in stage.rglob("*") if path.is_file())
        pd.DataFrame({"file": [*files, LISTING]}).to_csv(stage / LISTING, index=False, lineterminator="\n")
        _move(stage, folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def require_own_folder(folder: Path, page: str, error: type[ValueError] = ValueError) -> None:
    """Refuse a folder that is none for results: a file, `/`, the home folder, or one without ``page`` in its listing.

    Raises
    ------
    ValueError
        Of the type ``error``: a sentence that begins with OUT.
    """
    if folder.exists() and not folder.is_dir():
        raise error(f"OUT: {folder} is a file; give a folder.")
    new = folder / "results"
    if folder.resolve() in (Path(folder.resolve().anchor), Path(os.path.expanduser("~")).resolve()):
        raise error(f"OUT: {folder} is no folder for results; give a new one, such as OUT={new}.")
    entries = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    listing = (folder / LISTING).read_text(encoding="utf-8", errors="replace") if LISTING in entries else ""
    if entries and page not in listing.splitlines():
        raise error(f"OUT: {folder} holds files of others, such as {entries[0]}; give a new folder, such as OUT={new}.")


def _move(stage, folder):
    """Move all files of ``stage`` into ``folder``, and remove those that only an earlier run has listed there."""
    new = {path.relative_to(stage) for path in stage.rglob("*") if path.is_file()}
    if not folder.exists():
        stage.chmod(0o777 & ~umask())  # mkdtemp is private; a result is not
        os.replace(stage, folder)
        return
    old = _listed(folder)
    for path in sorted(new - {Path(LISTING)}):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        os.replace(stage / path, folder / path)
    for path in old - new:
        (folder / path).unlink(missing_ok=True)
    os.replace(stage / LISTING, folder / LISTING)


def _listed(folder):
    """The files that an earlier run has listed, but none outside the folder."""
    import pandas as pd

    try:
        names = pd.read_csv(folder / LISTING)["file"].astype(str)
    except (OSError, ValueError, KeyError):
        return set()
    paths = {PurePosixPath(name) for name in names}
    return {Path(path) for path in paths if not path.is_absolute() and ".." not in path.parts and str(path) != LISTING}
