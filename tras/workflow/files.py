"""Files that are either whole or not there, text in Markdown, and where the project is."""

import contextlib
import os
import tempfile
from pathlib import Path


@contextlib.contextmanager
def replacing(path: str | Path):
    """A temporary path beside ``path`` to write to; moved onto ``path`` when the block ends well, removed otherwise.

    The temporary name keeps the suffix, because writers such as matplotlib and NumPy choose the format by it.

    Raises
    ------
    OSError
        If the file cannot be written (no permission, disk full); the sentence names the final path.

    Examples
    --------
    >>> folder = tempfile.mkdtemp()
    >>> with replacing(Path(folder) / "a.txt") as temporary:
    ...     _ = temporary.write_text("whole")
    >>> os.listdir(folder)
    ['a.txt']
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~umask())  # mkstemp is private; a result is not
        os.replace(temporary, path)
    except OSError as error:
        problem = f"{path} could not be written ({error.strerror or error})"
        raise OSError(error.errno, f"{problem}; nothing was left under that name") from error
    finally:
        temporary.unlink(missing_ok=True)


def require_writable(folder: str | Path) -> None:
    """Make the folder if it is missing; an OSError unless files can be made in it, before anything is computed."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = f"{folder} cannot be written ({error.strerror or error})"
        raise OSError(error.errno, f"{reason}; give it back to you, or name another folder") from None


def markdown_table(rows) -> str:
    """Rows of text, the heading first, as a table in Markdown.

    >>> print(markdown_table([("a", "b"), ("1", "2")]))
    | a | b |
    | --- | --- |
    | 1 | 2 |
    """
    head, *body = rows
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *body))


def write_between(path: str | Path, begin: str, end: str, content: str) -> None:
    """Write ``content`` into the file ``path``, in place of what stands between the lines ``begin`` and ``end``.

    Raises
    ------
    ValueError
        If the file cannot be read, or a marker is missing or stands twice.
    OSError
        If it cannot be written; it is then as it was.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): check the path.") from error
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"{path} must hold {begin!r} and {end!r} once each, around the table; put them back.")
    before, rest = text.split(begin)
    with replacing(path) as temporary:
        temporary.write_text(f"{before}{begin}\n{content}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def project_root(start: str | Path | None = None) -> Path:
    """The nearest folder that holds `pyproject.toml` and `tras/`, from ``start`` (default: the working folder) upwards.

    Raises
    ------
    FileNotFoundError
        When there is none.
    """
    start = Path(start or Path.cwd()).resolve()
    for folder in (start, *start.parents):
        if (folder / "pyproject.toml").is_file() and (folder / "tras").is_dir():
            return folder
    remedy = "start the notebook from inside the project's checkout"
    raise FileNotFoundError(f"no folder with pyproject.toml and tras/ at or above {start}: {remedy}.")


def working_folder() -> Path:
    """The `project_root` at or above the working folder, or outside a checkout the working folder itself."""
    try:
        return project_root()
    except FileNotFoundError:
        return Path.cwd()


def umask() -> int:
    """The permissions that new files of this process do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
