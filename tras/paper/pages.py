"""The tables of README.md and docs/paper.md, each between its two markers.

``python -m tras.paper.pages`` prints them, or those that are named; with ``--write`` it writes them into their pages
(`make readme`); with ``--check`` it says which page holds another one.
"""

import argparse
import sys
from pathlib import Path

from tras.paper import tables
from tras.workflow.arguments import did_you_mean
from tras.workflow.files import write_between

TABLES = {  # name -> page, CSV files of its rows, function of its module for Markdown, the one for a terminal
    "findings": ("README.md", ("data/claims.csv", "figures/readings_nearest.csv"), "findings", "findings"),
    "table": ("README.md", ("figures/table.csv",), "first_markdown", "text"),
    "verdicts": ("README.md", ("data/claims.csv",), "verdicts", "text"),
    "errors": ("docs/paper.md", (), "markdown", "markdown"),
    "readings": ("docs/paper.md", (), "markdown", "markdown"),
}


def _module(name):
    """The module of a table, imported when it is asked for: `make all` prints one, and fast."""
    if name in ("findings", "verdicts"):
        from tras.paper import claims as module
    elif name == "errors":
        from tras.paper import errata as module
    elif name == "readings":
        from tras.paper import readings as module
    else:
        module = tables
    return module


def markers(name: str) -> tuple[str, str]:
    """The two lines between which a page holds the table ``name``."""
    return f"<!-- {name}: written by `make readme` -->", f"<!-- end of {name} -->"


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tras.paper.pages", description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(TABLES)}; all of them if none is named")
    for folder in ("data", "figures"):
        parser.add_argument(f"--{folder}", type=Path, default=Path(folder), help="folder (default: %(default)s)")
    parser.add_argument("--pages", type=Path, default=Path(), help="folder of README.md and docs/ (default: this one)")
    parser.add_argument("--write", action="store_true", help="write the tables into the pages, between their markers")
    parser.add_argument("--check", action="store_true", help="say whether the pages hold the tables as they are now")
    options = parser.parse_args(arguments)
    try:
        for name in options.names or TABLES:
            if name not in TABLES:
                raise ValueError(f"there is no table {name!r}{did_you_mean(name, TABLES)}")
            page, files, as_markdown, as_text = TABLES[name]
            page, rows = options.pages / page, []
            for file in files:
                folder, _, file = file.partition("/")
                path = getattr(options, folder) / file
                if not path.is_file():
                    raise ValueError(f"{path} does not exist; `make all` makes it.")
                rows.append(tables.read(path))
            content = getattr(_module(name), as_markdown)(*rows)
            if options.write:
                write_between(page, *markers(name), content)
                continue
            print(content if as_text == as_markdown else getattr(_module(name), as_text)(*rows))
            if options.check and content not in page.read_text(encoding="utf-8"):
                print(f"\n{page} holds another table; `make readme` writes this one into it.")
    except (OSError, ValueError, KeyError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
