"""Which stages are out of date, by content: one key file per notebook.

Make compares times, and a touched file or a fresh clone changes the time and nothing else. So make asks here first.
`NAME.key` lists what the result of a notebook depends on, one part per line:

- the notebook's code cells and their tags;
- the modules of `tras` that the cells import, directly or not, as syntax trees without comments and docstrings;
- package data, such as a style sheet, that one of these modules names;
- the notebook's own section of the parameter file;
- `environment.txt` and the version of Python.

The file is rewritten only when a line changed; make's comparison of times does the rest. A stage whose outputs are no
longer the ones that it wrote, by the checksums that the runner left in `NAME.json`, is out of date as well.

Standard library only, and run as a plain script, because it runs at every `make`:

    python3 tras/workflow/staleness.py --build build/paper --params params/paper.yaml notebooks/01_data_generation.ipynb
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import re
import sys
from pathlib import Path

PACKAGE = "tras"
TABLE = "_ROOMS"  # the dict in tras/__init__.py: public name -> module that defines it


def digest(content: str | bytes) -> str:
    """Sixteen hexadecimal digits that stand for a content.

    >>> digest("a") == digest(b"a") != digest("b")
    True
    """
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:16]


def write_atomically(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


# --- what a piece of code needs of the package ---


def nodes(tree: ast.AST):
    """Walk through a tree, leaving out `if TYPE_CHECKING:`, which never runs."""
    todo = [tree]
    while todo:
        node = todo.pop()
        yield node
        if _for_types(node):
            todo.extend(node.orelse)
        else:
            todo.extend(ast.iter_child_nodes(node))


def _for_types(node):
    """Whether this is `if TYPE_CHECKING:`."""
    return isinstance(node, ast.If) and getattr(node.test, "id", getattr(node.test, "attr", "")) == "TYPE_CHECKING"


class Package:
    """The modules of a package in a folder of its name, read but not imported."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.name = folder.name
        self.paths = {self._module_name(path): path for path in sorted(folder.rglob("*.py"))}
        self.data = [p for p in sorted(folder.rglob("*")) if p.suffix not in (".py", ".pyc") and p.is_file()]
        self._trees: dict[str, ast.Module | None] = {}
        self.table, self.names = self._read_table()

    def _module_name(self, path: Path) -> str:
        parts = path.relative_to(self.folder.parent).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    def tree(self, module: str) -> ast.Module | None:
        """The syntax tree of a module without its docstrings, None when it does not parse."""
        if module not in self._trees:
            self._trees[module] = without_docstrings(_parsed(self.paths[module].read_bytes()))
        return self._trees[module]

    def _read_table(self) -> tuple[dict, set]:
        """The table of public names in `__init__.py`, and the names that this file itself defines."""
        table, names = {}, set()
        tree = self.tree(self.name) if self.name in self.paths else None
        for node in tree.body if tree else []:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                names.add(node.name)
            for target in getattr(node, "targets", [getattr(node, "target", None)]):
                if isinstance(target, ast.Name):
                    names.add(target.id)
                    if target.id == TABLE:
                        table = _literal(node.value, {})
        return table, names

    def attribute(self, name: str) -> set[str]:
        """Modules behind `tras.name`; all of them when that cannot be told."""
        if f"{self.name}.{name}" in self.paths:
            return {f"{self.name}.{name}"}
        if name in self.table:
            room = str(self.table[name]).lstrip(".")
            room = room if room.startswith(self.name + ".") else f"{self.name}.{room}"
            return {room} if room in self.paths else set(self.paths)
        return set() if name in self.names or re.fullmatch("__.*__", name) else set(self.paths)

    def _named(self, dotted: str) -> set[str]:
        """The modules that importing a dotted name brings in: `tras.a.b` means `tras`, `tras.a` and `tras.a.b`."""
        parts = dotted.split(".")
        return {".".join(parts[: n + 1]) for n in range(len(parts))} & set(self.paths)

    def needs(self, tree: ast.AST | None, module: str = "") -> set[str]:
        """Modules that a tree imports itself; all, if it is None: the run will say what is wrong with the code.

        ``module`` is the one that the tree comes from, for relative imports; empty for a notebook.
        """
        if tree is None:
            return set(self.paths)
        needed, handles, resolved = set(), set(), set()
        for node in nodes(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    if alias.name.split(".")[0] == self.name:
                        needed |= self._named(alias.name)
                        if alias.name == self.name or not alias.asname:  # the name now stands for the package itself
                            handles.add(alias.asname or self.name)
            elif isinstance(node, ast.ImportFrom):
                needed |= self._from(node, module)
            elif isinstance(node, ast.Call) and module != self.name:  # its __getattr__ is what the table is for
                needed |= self._dynamic(node)
        for node in nodes(tree) if handles else ():  # an attribute comes before the name that it belongs to
            if isinstance(node, ast.Attribute) and getattr(node.value, "id", None) in handles:
                needed |= self.attribute(node.attr)
                resolved.add(node.value)
            elif isinstance(node, ast.Name) and node.id in handles and node not in resolved:
                return set(self.paths)  # the package as a value, getattr(tras, name): anything may be meant
        return needed

    def _from(self, node: ast.ImportFrom, module: str) -> set[str]:
        base = node.module or ""
        if node.level:
            is_package = module in self.paths and self.paths[module].name == "__init__.py"
            parts = module.split(".")
            base = ".".join([*parts[: len(parts) - node.level + is_package], base]).rstrip(".")
        if base.split(".")[0] != self.name:
            return set()
        needed = self._named(base)
        for alias in node.names:
            needed |= self.attribute(alias.name) if base == self.name else self._named(f"{base}.{alias.name}")
        return needed

    def _dynamic(self, node: ast.Call) -> set[str]:
        called = getattr(node.func, "id", getattr(node.func, "attr", ""))
        if called not in ("import_module", "__import__") or not node.args:
            return set()
        target = _literal(node.args[0], None)
        return self._named(target) if isinstance(target, str) and not target.startswith(".") else set(self.paths)

    def closure(self, modules: set[str], without: str = "") -> set[str]:
        """A set of modules together with all that they need in turn, and the packages that they are in.

        ``without``: a room that is left out, with what is needed by it alone.
        """
        todo, closed = set(modules), set()
        while todo:
            module = todo.pop()
            if without and f"{module}.".startswith(f"{without}."):
                continue
            closed.add(module)
            todo |= (self.needs(self.tree(module), module) | self._named(module)) - closed
        return closed

    def fingerprint(self, module: str) -> dict[str, str]:
        """Digests of a module and of the package data that it names."""
        tree = self.tree(module)
        if tree is None:
            return {module: digest(self.paths[module].read_bytes())}
        body = tree.body
        if module == self.name:  # a new line of the table concerns only who uses it
            body = [node for node in body if TABLE not in [getattr(t, "id", "") for t in getattr(node, "targets", [])]]
            body = [node for node in body if not _for_types(node)]  # the same table once more, for editors
        code = "\n".join(ast.dump(node) for node in body)
        data = {f"{self.name}/{path.name}": digest(path.read_bytes()) for path in self.data if path.name in code}
        return {module: digest(code)} | data


def without_docstrings(tree: ast.Module | None) -> ast.Module | None:
    """The same tree, after the docstrings of its module, classes and functions were taken out.

    >>> ast.unparse(without_docstrings(ast.parse("def f():\\n    'Adds.'\\n    return 'a' 'b'")))
    "def f():\\n    return 'ab'"
    """
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(tree) if tree else ():
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    return tree


def _parsed(source: str | bytes) -> ast.Module | None:
    try:
        return ast.parse(source)
    except (SyntaxError, ValueError):
        return None


def _literal(node: ast.AST, otherwise):
    try:
        return ast.literal_eval(node)
    except (ValueError, TypeError):
        return otherwise


# --- what a notebook depends on ---


def code_cells(path: Path) -> list[tuple[str, list[str]]]:
    """Source and tags of the code cells of a notebook (tags: papermill and nbval act on them)."""
    try:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        return [("".join(cell["source"]), sorted(cell.get("metadata", {}).get("tags", []))) for cell in code]
    except OSError as error:
        raise SystemExit(f"{path} cannot be read ({error.strerror}): give the path of a notebook.") from None
    except (ValueError, KeyError, TypeError):
        raise SystemExit(f"{path} is not a notebook (nbformat 4): restore it from git.") from None


def cells_tree(sources: list[str]) -> ast.Module | None:
    """The code of all cells as one tree, without IPython's magics; None when a cell does not parse."""
    body = []
    for source in sources:
        plain = re.sub(r"^%%.*", "", source)
        plain = re.sub(r"^([ \t]*)[%!?].*$", r"\1pass", plain, flags=re.MULTILINE)
        tree = _parsed(source) or _parsed(plain)
        if tree is None:
            return None
        body += tree.body
    return ast.Module(body=body, type_ignores=[])


def params_section(text: str, name: str) -> str:
    """One notebook's section of a parameter file, without comments.

    The standard library reads no YAML, so the text is cut at its top-level keys. Where that could go wrong (anchors, a
    flow mapping, a second document) the whole text is returned: a run too many rather than one too few.

    >>> params_section("a:\\n  x: 1\\n  # why\\nb:\\n  x: 2\\n", "a")
    '  x: 1'
    """
    sections, current = {}, None
    for line in text.splitlines():
        if line.strip() and line[0] not in " #":
            key = re.fullmatch(r"""(["']?)([\w.-]+)\1\s*:(\s.*|)""", line)
            if not key:
                return text
            current = sections.setdefault(key[2], [])
            current.append(key[3])
        elif current is not None:
            current.append(line)
    lines = sections.get(name, [])
    if re.search(r"[&*][\w.-]|<<", text):
        return text
    if any(re.search(r"[|>][-+\d]*\s*$", line) for line in lines):  # in a block of text '#' is text
        return "\n".join(lines)
    lines = [line if re.search("[\"']", line) else re.sub(r"(^|\s)#.*", "", line).rstrip() for line in lines]
    return "\n".join(line for line in lines if line and not line.lstrip().startswith("#"))


def key_of(notebook: Path, params: Path, environment: Path, package: Package) -> str:
    """What a notebook's result depends on: per line the name of a part and its digest."""
    cells = code_cells(notebook)
    parts = {
        "code cells": digest(json.dumps(cells)),
        str(params): digest(params_section(_text(params), notebook.stem)),
        environment.name: digest(_text(environment)),
        "python": ".".join(map(str, sys.version_info[:2])),  # syntax trees, too, differ between versions
    }
    for module in sorted(package.closure(package.needs(cells_tree([source for source, _ in cells])))):
        parts.update(package.fingerprint(module))
    return "".join(f"{name}: {value}\n" for name, value in parts.items())


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        remedy = "restore it from git or correct the path"
        raise SystemExit(f"{path} cannot be read ({error.strerror}): {remedy}.") from None


def changed_outputs(record: Path, stamp: Path) -> list[str]:
    """What became of outputs that are not the ones that the stage wrote, by the record that the runner left.

    A stage without a stamp was not run to its end; one with a stamp and without a record cannot be trusted.
    """
    if not stamp.exists():
        return []
    try:
        outputs = json.loads(record.read_text(encoding="utf-8"))["outputs"]
        fates = {name: _fate(Path(name), written) for name, written in outputs.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return [f"{record} was deleted or damaged"]
    return [f"{name} was {fate}" for name, fate in fates.items() if fate]


def _fate(path: Path, written: dict) -> str:
    """What happened to a file, empty if nothing. The change time is beyond the reach of `touch`."""
    try:
        now = path.stat()
        if now.st_size != written["size"]:
            return f"changed ({now.st_size} bytes for {written['size']})"
        if (now.st_mtime_ns, now.st_ctime_ns) == (written["mtime_ns"], written["ctime_ns"]):
            return ""
        return "" if hashlib.sha256(path.read_bytes()).hexdigest() == written["sha256"] else "changed"
    except FileNotFoundError:
        return "deleted"
    except OSError as error:
        return f"made unreadable ({error.strerror})"


def refresh(notebook: Path, build: Path, key: str) -> str:
    """Rewrite a stage's key file if the stage is out of date.

    Returns why, with the name of every output that was changed; nothing when it is up to date or was never run.
    """
    path = build / f"{notebook.stem}.key"
    old = path.read_text(encoding="utf-8") if path.exists() else None
    stamp = path.with_suffix(notebook.suffix)
    spoilt = changed_outputs(path.with_suffix(".json"), stamp)
    if old == key and not spoilt:
        return ""
    write_atomically(path, key)
    if stamp.exists() and stamp.stat().st_mtime_ns >= path.stat().st_mtime_ns:
        later = stamp.stat().st_mtime_ns + 1_000_000  # the clock was set back: make would skip the stage
        os.utime(path, ns=(later, later))
    reasons = spoilt
    if old not in (None, key):
        changed = {line.rsplit(": ", 1)[0] for line in set(old.splitlines()) ^ set(key.splitlines())}
        more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
        reasons = [f"{', '.join(sorted(changed)[:3])}{more} changed", *spoilt]
    return f"{notebook.stem} is out of date: {', '.join(reasons)}" if reasons else ""


def raw_digest(paths: list[Path]) -> str:
    """Digest of whole files, missing ones included: when it is what it was, nothing needs to be parsed."""
    total = hashlib.sha256(sys.version.encode())
    for path in paths:
        content = path.read_bytes() if path.is_file() else b"missing"
        total.update(f"{path} {len(content)} ".encode() + content)
    return total.hexdigest()


def main(arguments: list[str] | None = None) -> int:
    """Command line: see the top of this file."""
    purpose = "Write NAME.key for each notebook whose code, parameters or outputs changed."
    parser = argparse.ArgumentParser(description=purpose)
    parser.add_argument("notebooks", nargs="+", type=Path)
    parser.add_argument("--build", required=True, type=Path, help="folder of the key files")
    parser.add_argument("--params", required=True, type=Path, help="parameter file, one section per notebook")
    parser.add_argument("--environment", type=Path, default=Path("environment.txt"))
    parser.add_argument("--package", type=Path, default=Path(PACKAGE), help="folder (default: %(default)s)")
    options = parser.parse_args(arguments)
    files = sorted(path for path in options.package.rglob("*") if "__pycache__" not in path.parts)
    raw = raw_digest([*options.notebooks, options.params, options.environment, *files])
    seen = options.build / ".inputs"
    keys = [options.build / f"{notebook.stem}.key" for notebook in options.notebooks]
    unchanged = seen.exists() and seen.read_text() == raw and all(key.exists() for key in keys)
    package = None if unchanged else Package(options.package)
    try:
        for notebook, path in zip(options.notebooks, keys):
            key = _text(path) if unchanged else key_of(notebook, options.params, options.environment, package)
            reason = refresh(notebook, options.build, key)
            if reason:
                print(reason, flush=True)
        write_atomically(seen, raw)
    except OSError as error:
        remedy = "make room there, then run make again"
        raise SystemExit(f"{options.build} cannot be written ({error.strerror}): {remedy}.") from None
    return 0


if __name__ == "__main__":
    sys.exit(main())
