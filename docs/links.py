"""Whether every link of the site leads somewhere inside it, and nothing is loaded from elsewhere.

``python docs/links.py build/docs`` says which do not, and ends with 1 if there are any. Links that a reader may follow
to other sites are not followed.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """The targets of a page, what it links to, and what it loads."""

    def __init__(self, text):
        super().__init__()
        self.targets, self.links, self.loads = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.targets |= {value for key in ("id", "name") if (value := attributes.get(key))}
        for key in ("href", "src", "data", "poster"):
            if attributes.get(key) is not None:
                linked = tag in ("a", "area") or attributes.get("rel") in ("next", "prev", "search", "index", "canonical")
                (self.links if linked else self.loads).append(attributes[key])


def problems(folder: Path) -> list[str]:
    """A sentence for each link that leads nowhere and for each thing that a page would load from elsewhere."""
    pages = {path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    sentences = []
    for path, page in pages.items():
        name = path.relative_to(folder.resolve())
        for link in [*page.links, *page.loads]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.loads and parts.scheme != "data":
                    sentences.append(f"{name} loads {link} from elsewhere")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file() or not target.is_relative_to(folder.resolve()):
                sentences.append(f"{name} links to {link}, which is not there")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].targets:
                sentences.append(f"{name} links to {link}, but that page has no such place")
    return sentences


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit status."""
    (folder,) = map(Path, sys.argv[1:] if arguments is None else arguments)
    if not (folder / "index.html").is_file():
        print(f"{folder} holds no index.html; `make docs` makes one.", file=sys.stderr)
        return 2
    sentences = list(dict.fromkeys(problems(folder)))
    for sentence in sentences:
        print(sentence, file=sys.stderr)
    return 1 if sentences else 0


if __name__ == "__main__":
    sys.exit(main())
