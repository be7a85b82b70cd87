"""Make the site, as `make docs` does: ``python docs/make_site.py build/docs``.

Sphinx wants its sources in one folder, so they are gathered there first: the pages of docs/, the README files, the
executed notebooks, and the figures and code that they show. A warning of Sphinx is an error, and so is a link that
leads nowhere inside the site, or a page that loads something from elsewhere. Links to other sites are not followed.
"""

import argparse
import os
import shutil
import sys
import tempfile
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.cmd import build as sphinx

from tras.paper.lookups import Sources

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("docs/*.md", "*.md", "data/README.md", "benchmarks/README.md", "benchmarks/results/*.png")
NOTEBOOKS = ("[0-9]*.ipynb", "explore.ipynb")  # the first as a run has left them; the explorer lives in a kernel only


def gather(folder: Path, sources: Sources) -> None:
    """Put what the site is made of into an empty ``folder``; pages of docs/ stand at its top."""
    for pattern in COPIED:
        for path in ROOT.glob(pattern):
            target = folder / path.relative_to(ROOT / "docs" if pattern.startswith("docs") else ROOT)
            target.parent.mkdir(exist_ok=True, parents=True)
            shutil.copy2(path, target)
    (folder / "README.md").unlink()  # the start page is docs/index.md
    (folder / "notebooks").mkdir()
    for path in (*sources.build.glob(NOTEBOOKS[0]), ROOT / "notebooks" / NOTEBOOKS[1]):
        if not path.name.endswith(".running.ipynb"):
            shutil.copy2(path, folder / "notebooks")
    (folder / "figures").symlink_to(sources.figures.resolve())
    (folder / "tras").symlink_to(ROOT / "tras")


def build(site: Path, sources: Sources) -> int:
    """Make the site anew, and put it in the place of an older one when it is whole; returns the exit status."""
    site.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=site.parent, prefix=".docs-") as work:
        source, made = Path(work, "source"), Path(work, "site")
        source.mkdir()
        gather(source, sources)
        options = ["-q", "-n", "-W", "--keep-going", "-c", str(ROOT / "docs"), "-d", str(Path(work, "doctrees"))]
        options += [f"-Dtras_{name}={path}" for name, path in sources._asdict().items()]
        if status := sphinx.main([*options, str(source), str(made)]):
            return status
        sentences = problems(made)
        if sentences:
            print(*sentences, sep="\n", file=sys.stderr)
            return 1
        if site.exists():
            os.replace(site, Path(work, "old"))
        os.replace(made, site)
    return 0


# --- links ------------------------------------------------------------------------------------------------------------


class _Page(HTMLParser):
    """The places of a page that a link can lead to, its links, and what it loads."""

    def __init__(self, text):
        super().__init__()
        self.targets, self.links, self.loads = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.targets |= {value for key in ("id", "name") if (value := attributes.get(key))}
        for key in ("href", "src", "data", "poster"):
            if attributes.get(key) is not None:
                linked = tag == "a" or attributes.get("rel") in ("next", "prev", "search", "index")
                (self.links if linked else self.loads).append(attributes[key])


def problems(site: Path) -> list[str]:
    """A sentence for each link that leads nowhere and for each thing that a page would load from elsewhere."""
    site = site.resolve()
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    sentences = []
    for path, page in pages.items():
        name = path.relative_to(site)
        for link in [*page.links, *page.loads]:
            parts = urlsplit(link)
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if parts.scheme or parts.netloc:
                if link in page.loads and parts.scheme != "data":
                    sentences.append(f"{name} loads {link} from elsewhere")
            elif not target.is_file() or not target.is_relative_to(site):
                sentences.append(f"{name} links to {link}, which is not there")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].targets:
                sentences.append(f"{name} links to {link}, but that page has no such place")
    return list(dict.fromkeys(sentences))


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit status: 0, 1 (a page has a fault), 2 (the call was wrong)."""
    parser = argparse.ArgumentParser(prog="python docs/make_site.py", description=__doc__.partition("\n")[0])
    parser.add_argument("site", type=Path, help="where the site goes, for example build/docs")
    for name, default in (("data", "data"), ("figures", "figures"), ("build", "build/paper")):
        parser.add_argument(f"--{name}", type=Path, default=Path(default), help="folder (default: %(default)s)")
    options = vars(parser.parse_args(arguments))
    site = options.pop("site")
    sources = Sources(**options)
    for path in sources:
        if not path.is_dir():
            print(f"{path} does not exist; {sources.command} makes it.", file=sys.stderr)
            return 2
    status = build(site, sources)
    if not status:
        size = sum(path.stat().st_size for path in site.rglob("*") if path.is_file())
        print(f"{site / 'index.html'}  {len(list(site.rglob('*.html')))} pages, {size / 1e6:.1f} MB")
    return status


if __name__ == "__main__":
    sys.exit(main())
