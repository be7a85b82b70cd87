"""Whether this machine's artefacts are those of `reference/`: by their bytes, else by their numbers and looks.

    python -m tras.paper.verification ARTEFACT ...   # compare these
    python -m tras.paper.verification --paper ARTEFACT ... --studies ARTEFACT ...   # compare all: `make verify`
    python -m tras.paper.verification --bless ...    # write reference/: `make bless`, and nothing else does

Three levels. Bytes: SHA-256. Numbers, if the bytes differ: every number of a CSV table, every channel of a recording,
every array of a model as its class in `tras.paper.classes` allows. Looks: root mean square difference of small grey
pictures. Only numbers outside tolerance, files that are not what their stage wrote, and files that are missing or
cannot be read make the exit status 1.
"""

import argparse
import collections
import json
import operator
import sys
from pathlib import Path

from tras.paper import artefacts as copies
from tras.paper import classes
from tras.workflow import provenance
from tras.workflow.files import replacing

# No NumPy at the top: with equal bytes there is nothing to calculate.

LOOKS = 2.0  # RMS of grey levels, 0 to 255; measured 0.01 without sensitive rows; a line moved by its width gives more

MANIFEST = "SHA256SUMS"  # `sha256sum -c reference/SHA256SUMS` reads it
INTERVALS = "intervals"  # folder in the reference: how far the rows of the sensitive classes scatter
FAILURES = ("DIFFERS", "CHANGED", "MISSING", "UNREADABLE")

Finding = collections.namedtuple("Finding", "artefact verdict detail share", defaults=("", 0.0))


# --- comparison -------------------------------------------------------------------------------------------------------


def compare(artefact: Path, sums: dict[str, str], reference: Path) -> Finding:
    """One artefact against its checksum in the manifest, and its copy in ``reference`` or its committed self."""
    if not artefact.is_file():
        return Finding(artefact, "MISSING", "it is not there: make all")
    if str(artefact) not in sums:
        return Finding(artefact, "MISSING", f"{reference} has no reference for it: make bless")
    try:
        checksum = provenance.checksum(artefact)
        if checksum == sums[str(artefact)]:
            return Finding(artefact, "same bytes")
        if not artefact.stat().st_size:
            raise ValueError("it is empty")
        finding = _compare_content(artefact, sums, reference)
    except FileNotFoundError as error:
        return Finding(artefact, "MISSING", str(error))
    except (OSError, ValueError) as error:
        return Finding(artefact, "UNREADABLE", str(error))
    if finding.verdict not in FAILURES and _stage_wrote(artefact) not in (checksum, None):
        detail = f"it is not what its stage wrote: make all; {finding.verdict}: {finding.detail}"
        return finding._replace(verdict="CHANGED", detail=detail)
    return finding


def _stage_wrote(artefact):
    """Checksum of what the stage wrote under this name; None if nobody knows."""
    try:
        return json.loads(provenance.beside(artefact).read_text(encoding="utf-8"))["sha256"]
    except (OSError, ValueError, KeyError):
        return None


def _compare_content(artefact, sums, reference):
    if artefact.suffix in copies.DRAWINGS:
        return Finding(artefact, "other bytes", f"see {artefact.stem}.png and {artefact.stem}.csv")
    copy, interval = copies.copy_of(artefact, reference), copies.stored(reference / INTERVALS / artefact)
    for path in (copy, interval if classes.sensitive(artefact) else None):
        if path is not None:
            _require_sound(path, sums)
    if copy is not None:
        return _compare_numbers(artefact, copy, interval)
    with copies.committed(artefact, sums[str(artefact)]) as copy:
        if artefact.suffix in copies.PICTURES:
            return _compare_looks(artefact, copy)
        return _compare_numbers(artefact, copy, interval)


def _require_sound(path, sums):
    """What the reference holds is what was blessed."""
    if not path.is_file():
        raise FileNotFoundError(f"the reference has lost {path}: git checkout {path}")
    if provenance.checksum(path) != sums.get(str(path)):
        raise ValueError(f"{path} is not what {path.parts[0]}/{MANIFEST} names: git checkout {path}")


def _compare_numbers(artefact, copy, interval):
    share, detail = _deviation(artefact, copy, interval)
    if share > 1:
        detail += f", {share:.2g} times what is allowed" if share < float("inf") else ""
        return Finding(artefact, "DIFFERS", detail, share)
    detail = f"furthest off: {detail}, {share:.2g} of what is allowed" if detail else "all equal"
    return Finding(artefact, "numbers agree", detail, share)


def _deviation(artefact, copy, interval):
    """The largest deviation of an artefact from its copy as a share of what its class allows, and a sentence."""
    ours, theirs, rule = copies.read_columns(artefact), copies.read_copy(copy), classes.exact(artefact)
    sensitive = classes.sensitive(artefact)
    if sensitive is None:
        return classes.compare_columns(ours, theirs, rule)
    theirs = {name: values for name, (_, values) in theirs.items()}
    intervals = {name: values for name, (_, values) in copies.read_copy(interval).items()}
    return classes.compare_table(ours, theirs, intervals, rule, sensitive)


def _compare_looks(artefact, copy):
    ours, theirs = copies.picture(artefact), copies.picture(copy)
    if ours.shape != theirs.shape:
        sizes = ["{1}x{0}".format(*(copies.SMALLER * size for size in picture.shape)) for picture in (ours, theirs)]
        return Finding(artefact, "looks different", f"{sizes[0]} pixels for {sizes[1]}")
    rms = float(((ours - theirs) ** 2).mean() ** 0.5)
    return Finding(artefact, "looks the same" if rms <= LOOKS else "looks different", f"RMS {rms:.2f} of 255")


# --- the commands -----------------------------------------------------------------------------------------------------


def read_manifest(reference: Path) -> tuple[list[str], dict[str, str]]:
    """Where the reference comes from, and the SHA-256 of each artefact; a ValueError if either is missing."""
    lines = (reference / MANIFEST).read_text(encoding="utf-8").splitlines()
    sums = dict(reversed(line.split("  ", 1)) for line in lines if line and not line.startswith("#"))
    remarks = [line.lstrip("# ") for line in lines if line.startswith("#")]
    if not remarks:
        raise ValueError(f"{reference / MANIFEST} does not say where the reference comes from")
    return remarks, sums


def verify(parts: dict[str, list[Path]], reference: Path) -> int:
    """Compare, print a line for each part and each artefact, and a summary; the exit status.

    Parameters
    ----------
    parts : dict of str to list of Path
        Name of a part -> its artefacts. Under the name "" they are some of all, and nothing is said of the others.
    reference : Path
    """
    try:
        remarks, sums = read_manifest(reference)
    except (OSError, ValueError):
        advice = f"git checkout {reference}, or make bless to take this machine's results"
        print(f"{reference / MANIFEST} is missing or no manifest: {advice}.", file=sys.stderr)
        return 2
    findings = {part: [compare(path, sums, reference) for path in artefacts] for part, artefacts in parts.items()}
    if "" not in parts:
        built = {str(artefact) for artefacts in parts.values() for artefact in artefacts}
        gone = [name for name in sums if name not in built and not name.startswith(f"{reference}/")]
        findings[list(parts)[-1]] += [Finding(Path(n), "MISSING", "make no longer builds it: make bless") for n in gone]
        for part, some in findings.items():
            failed = sum(finding.verdict in FAILURES for finding in some)
            print(f"{part}: not verified, {failed} of {len(some)} artefacts" if failed else f"{part}: verified")
        print()
    findings = [finding for some in findings.values() for finding in some]
    for finding in findings:
        print(f"{finding.verdict:15}  {finding.artefact}" + (f"  ({finding.detail})" if finding.detail else ""))
    counts = collections.Counter(finding.verdict for finding in findings)
    failed = sum(counts[verdict] for verdict in FAILURES)
    print(f"\n{len(findings)} artefacts: {', '.join(f'{count} {verdict}' for verdict, count in counts.items())}.")
    if counts["same bytes"] < len(findings):
        finite = [finding for finding in findings if finding.share < float("inf")]
        furthest = max(finite, key=operator.attrgetter("share"), default=None)
        if furthest is not None and furthest.share:
            print(f"Largest deviation: {furthest.share:.2g} of what is allowed, {furthest.artefact}.")
        else:
            print("No number deviates." if finite else "No number could be compared.")
        print("The reference comes from", *remarks)
    faults = f"{failed} outside tolerance, changed, missing or unreadable"
    print(f"Not verified: {faults}; docs/verify.md says what to do." if failed else "Verified.")
    return 1 if failed else 0


def bless(artefacts: list[Path], reference: Path) -> int:
    """Write copies, intervals and manifest anew, and remove what no artefact needs any more; the exit status."""
    missing = [str(artefact) for artefact in artefacts if not artefact.is_file()]
    if missing:
        print(f"{', '.join(missing)} missing: make all first; {reference} is as it was.", file=sys.stderr)
        return 1
    try:
        old = read_manifest(reference)[1]
    except (OSError, ValueError):
        old = {}
    sums = {str(artefact): provenance.checksum(artefact) for artefact in artefacts}
    manifest = reference / MANIFEST
    try:
        written = _write_intervals([path for path in artefacts if classes.sensitive(path)], reference / INTERVALS)
        written += [copy for artefact in artefacts if (copy := copies.write_copy(artefact, reference))]
        sums |= {str(path): provenance.checksum(path) for path in sorted(written)}
        with replacing(manifest) as temporary:
            lines = [f"# {provenance.summary()}", *(f"{value}  {name}" for name, value in sums.items())]
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    size, needed = 0, {*written, manifest, reference / "README.md"}
    for path in filter(Path.is_file, list(reference.rglob("*"))):
        if path in needed:
            size += path.stat().st_size
        else:
            path.unlink()
    names = set(map(str, artefacts)) | {name for name in old if not name.startswith(f"{reference}/")}
    changed = [name for name in sorted(names) if sums.get(name) != old.get(name)]
    news = f"{len(changed)} new or changed: {', '.join(changed) or 'none'}"
    print(f"{reference}: {len(artefacts)} artefacts, {size / 1e6:.2f} MB; {news}.")
    return 0


def _write_intervals(tables, folder):
    """The intervals of the tables with sensitive rows, which take a while: the paths."""
    if not tables:
        return []
    from tras.paper import sensitivity

    written, options = [], {"index": False, "float_format": "%.10g", "lineterminator": "\n"}
    for table, frame in sensitivity.spreads(tables, progress=sys.stderr).items():
        written.append(copies.write_packed(folder / table, frame.to_csv(**options).encode()))
    return written


def main(arguments: list[str] | None = None) -> int:
    """Command line; the exit status: 0, 1 (not verified), 2 (there is nothing to compare with)."""
    parser = argparse.ArgumentParser("python -m tras.paper.verification", description=__doc__.partition("\n")[0])
    some = {"nargs": "*", "default": [], "type": Path, "metavar": "ARTEFACT"}
    parser.add_argument("artefacts", **some, help="files as make builds them; nothing is said of the others")
    parser.add_argument("--paper", **some, help="all files of the paper's part")
    parser.add_argument("--studies", **some, help="all files of the further studies")
    parser.add_argument("--reference", type=Path, default=Path("reference"), help="folder (default: %(default)s)")
    parser.add_argument("--bless", action="store_true", help="write the reference from these files")
    options = parser.parse_args(arguments)
    everything = {"the paper's part": options.paper, "the studies": options.studies}
    if bool(options.artefacts) == any(everything.values()):
        parser.error("name some artefacts, or with --paper and --studies all of them.")
    if options.bless:
        return bless([*options.artefacts, *options.paper, *options.studies], options.reference)
    return verify({"": options.artefacts} if options.artefacts else everything, options.reference)


if __name__ == "__main__":
    sys.exit(main())
