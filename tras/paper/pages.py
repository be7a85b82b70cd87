"""The tables of README.md and docs/paper.md, each between its two markers: print, write or check them.

``python -m tras.paper.pages`` prints them, or those that are named; with ``--write`` it writes them into their pages (`make
readme`); with ``--check`` it says which page holds another one.
"""

import argparse
import sys
from pathlib import Path

from tras.paper import tables
from tras.workflow.arguments import did_you_mean
from tras.workflow.files import write_between

# What a table needs is imported when it is asked for: `make all` prints one, and fast.


def _claims(rows):
    from tras.paper import claims

    return claims.markdown(rows)


def _claims_text(rows):
    from tras.paper import claims

    return claims.text(rows)


def _errata():
    from tras.paper import errata

    return errata.markdown()


def _readings():
    from tras.paper import readings

    return readings.markdown()


TABLES = {  # name -> (page, CSV file whose rows go in, if any; the table in Markdown; for a terminal, if that is another)
    "table": ("README.md", "figures/table.csv", tables.markdown, tables.text),
    "comparison": ("README.md", "data/comparison.csv", tables.methods_markdown, None),
    "claims": ("README.md", "data/claims.csv", _claims, _claims_text),
    "errors": ("docs/paper.md", "", _errata, None),
    "readings": ("docs/paper.md", "", _readings, None),
}


def markers(name):
    """The two lines between which a page holds the table ``name``."""
    return f"<!-- {name}: written by `make readme` -->", f"<!-- end of {name} -->"


def main(arguments=None):
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m tras.paper.pages", description="Print the tables of README and docs, or write them there."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(TABLES)}; all of them if none is named")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of the data (default: data)")
    parser.add_argument(
        "--figures", type=Path, default=Path("figures"), help="folder of the figures (default: figures)"
    )
    parser.add_argument("--pages", type=Path, default=Path(), help="folder of README.md and docs/ (default: this one)")
    parser.add_argument("--write", action="store_true", help="write the tables into the pages, between their markers")
    parser.add_argument("--check", action="store_true", help="say whether the pages hold the tables as they are now")
    options = parser.parse_args(arguments)
    try:
        for name in options.names or TABLES:
            if name not in TABLES:
                raise ValueError(f"there is no table {name!r}{did_you_mean(name, TABLES)}")
            page, file, as_markdown, as_text = TABLES[name]
            page, path = (
                options.pages / page,
                (options.data if file.startswith("data/") else options.figures) / Path(file).name,
            )
            if file and not path.is_file():
                raise ValueError(f"{path} does not exist; `make all` makes it.")
            rows = [tables.read(path)] if file else []
            content = as_markdown(*rows)
            if options.write:
                write_between(page, *markers(name), content)
                continue
            print(as_text(*rows) if as_text else content)
            if options.check and content not in page.read_text(encoding="utf-8"):
                print(f"\n{page} holds another table; `make readme` writes this one into it.")
    except (OSError, ValueError, KeyError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
