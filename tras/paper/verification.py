"""Whether this machine's artefacts are those of `reference/`: by their bytes, else by their numbers and looks.

    python -m tras.paper.verification ARTEFACT ...           # compare: `make verify`
    python -m tras.paper.verification --bless ARTEFACT ...   # write reference/: `make bless`, and nothing else does

Three levels. Bytes: SHA-256. Numbers, if the bytes differ: every column of a CSV table, every channel of a recording,
every array of a model within `TOLERANCES`; whole numbers and text exactly. Looks: root mean square difference of small
grey pictures. Only numbers outside tolerance, and files that are missing or cannot be read, make the exit status 1.
"""

import argparse
import collections
import fnmatch
import operator
import sys
from pathlib import Path

from tras.paper import artefacts as copies
from tras.workflow import provenance
from tras.workflow.files import replacing

# No NumPy at the top: with equal bytes there is nothing to calculate.

# The first pattern that fits: |ours - reference| <= rtol |reference| + atol (largest |reference| in a column) + FLOOR.
# Measured with other BLAS kernels, two threads, and without AVX in BLAS, NumPy and libm (docs/verify.md): rtol and
# FLOOR were enough; atol is for numbers on their way through zero.
TOLERANCES = [
    # pattern, rtol, atol, why
    ("*.nc", 1e-9, 1e-12, "a stable closed loop forgets rounding: 4e-15 of a channel's largest value"),
    (
        "*.npz",
        1e-6,
        1e-10,
        "rounding times a condition number: 7e-13 of a matrix's largest entry, 1e-3 of its smallest",
    ),
    ("*.csv", 1e-6, 1e-10, "errors of models, the smallest as differences of nearly equal numbers: 1e-7 of a value"),
]
FLOOR = 1e-12  # smaller numbers are rounding in every unit used here: residuals that would be zero in exact arithmetic
LOOKS = 2.0  # RMS of grey levels, 0 to 255; measured 0.0; a line moved by its own width gives more (see the tests)

MANIFEST = "SHA256SUMS"  # `sha256sum -c reference/SHA256SUMS` reads it
FAILURES = ("DIFFERS", "MISSING", "UNREADABLE")

Finding = collections.namedtuple("Finding", "artefact verdict detail share", defaults=("", 0.0))


# --- comparison -------------------------------------------------------------------------------------------------------


def tolerance(artefact: Path) -> tuple[float, float]:
    """(rtol, atol) for an artefact by `TOLERANCES`."""
    return next((rtol, atol) for pattern, rtol, atol, _ in TOLERANCES if fnmatch.fnmatch(str(artefact), pattern))


def compare_columns(ours: dict, theirs: dict, rtol: float, atol: float) -> tuple[float, str]:
    """The largest deviation as a share of what is allowed, and a sentence on it.

    Parameters
    ----------
    ours : dict of str to ndarray
        As from `tras.paper.artefacts.read_columns`.
    theirs : dict of str to (rows, ndarray)
        Values in the reference, and the rows of ours that they stand for; ``None`` for all rows.

    Returns
    -------
    share : float
        Above 1 outside tolerance; infinite for another shape, text, whole number, NaN or infinity.
    detail : str
        The column, row and both values; empty if nothing differs.
    """
    if set(ours) != set(theirs):
        name = min(set(ours) ^ set(theirs))
        return float("inf"), f"column {name} is only in {'ours' if name in ours else 'the reference'}"
    worst, detail = 0.0, ""
    for name, (rows, reference) in theirs.items():
        length = len(reference) if rows is None else rows[-1] + 1
        if len(ours[name]) != length:
            return float("inf"), f"{name} has {len(ours[name])} rows, the reference {length}"
        values = ours[name] if rows is None else ours[name][rows]
        shares = _shares(values, reference, rtol, atol)
        i, outside = int(shares.argmax()), int((shares > 1).sum())
        if shares[i] > worst:
            worst, row = float(shares[i]), i if rows is None else int(rows[i])
            detail = f"{name}, row {row + 1}: {_apart(values[i].item(), reference[i].item())}"
            detail += f", and {outside - 1} more in this column" if outside > 1 else ""
    return worst, detail


def _apart(value, reference):
    ours, theirs = copies.text(value), copies.text(reference)
    return f"{ours} for {theirs}" if ours != theirs else f"{theirs}, off by {abs(value - reference):.1e}"


def _shares(values, reference, rtol, atol):
    """|values - reference| as shares of what is allowed, elementwise."""
    import numpy as np

    kinds = {values.dtype.kind, reference.dtype.kind}
    if not kinds <= set("iub") and kinds <= set("iubf"):
        values, reference = values.astype(float), reference.astype(float)
        finite = np.isfinite(reference)
        allowed = rtol * np.abs(reference) + atol * np.abs(reference[finite]).max(initial=0) + FLOOR
        with np.errstate(invalid="ignore"):
            shares = np.where(finite & np.isfinite(values), np.abs(values - reference) / allowed, np.inf)
        return np.where((values == reference) | (np.isnan(values) & np.isnan(reference)), 0.0, shares)
    if not kinds <= set("iub"):
        values, reference = values.astype(str), reference.astype(str)
    return np.where(values == reference, 0.0, np.inf)


def compare(artefact: Path, expected: str | None, reference: Path) -> Finding:
    """One artefact against its checksum, and its copy in the folder ``reference`` or its committed self."""
    if not artefact.is_file():
        return Finding(artefact, "MISSING", "it is not there: make all")
    if expected is None:
        return Finding(artefact, "MISSING", f"{reference} has no reference for it: make bless")
    try:
        if provenance.checksum(artefact) == expected:
            return Finding(artefact, "same bytes")
        if not artefact.stat().st_size:
            raise ValueError("it is empty")
        if artefact.suffix in copies.DRAWINGS:
            return Finding(artefact, "other bytes", f"see {artefact.stem}.png and {artefact.stem}.csv")
        copy = copies.copy_of(artefact, reference)
        if copy is None:
            compare_content = _compare_looks if artefact.suffix in copies.PICTURES else _compare_numbers
            with copies.committed(artefact, expected) as copy:
                return compare_content(artefact, copy)
        if not copy.is_file():
            return Finding(artefact, "MISSING", f"the reference has lost {copy}: git checkout {copy}")
        return _compare_numbers(artefact, copy)
    except FileNotFoundError as error:
        return Finding(artefact, "MISSING", str(error))
    except (OSError, ValueError) as error:
        return Finding(artefact, "UNREADABLE", str(error))


def _compare_numbers(artefact, copy):
    share, detail = compare_columns(copies.read_columns(artefact), copies.read_copy(copy), *tolerance(artefact))
    if share > 1:
        detail += f", {share:.2g} times what is allowed" if share < float("inf") else ""
        return Finding(artefact, "DIFFERS", detail, share)
    detail = f"furthest off: {detail}, {share:.2g} of what is allowed" if detail else "all equal"
    return Finding(artefact, "numbers agree", detail, share)


def _compare_looks(artefact, copy):
    ours, theirs = copies.picture(artefact), copies.picture(copy)
    if ours.shape != theirs.shape:
        sizes = ["{1}x{0}".format(*(copies.SMALLER * size for size in picture.shape)) for picture in (ours, theirs)]
        return Finding(artefact, "looks different", f"{sizes[0]} pixels for {sizes[1]}")
    rms = float(((ours - theirs) ** 2).mean() ** 0.5)
    return Finding(artefact, "looks the same" if rms <= LOOKS else "looks different", f"RMS {rms:.2f} of 255")


# --- the commands -----------------------------------------------------------------------------------------------------


def read_manifest(reference: Path) -> tuple[list[str], dict[str, str]]:
    """The manifest's remarks, and its SHA-256 per artefact."""
    lines = (reference / MANIFEST).read_text(encoding="utf-8").splitlines()
    sums = dict(reversed(line.split("  ", 1)) for line in lines if line and not line.startswith("#"))
    return [line.lstrip("# ") for line in lines if line.startswith("#")], sums


def verify(artefacts: list[Path], reference: Path) -> int:
    """Compare, print a line for each artefact and a summary; the exit status."""
    try:
        remarks, sums = read_manifest(reference)
    except (OSError, ValueError):
        advice = f"git checkout {reference}, or make bless to take this machine's results"
        print(f"{reference / MANIFEST} is missing or no manifest: {advice}.", file=sys.stderr)
        return 2
    findings = [compare(artefact, sums.pop(str(artefact), None), reference) for artefact in artefacts]
    findings += [Finding(Path(name), "MISSING", "make no longer builds it: make bless") for name in sums]
    for finding in findings:
        print(f"{finding.verdict:15}  {finding.artefact}" + (f"  ({finding.detail})" if finding.detail else ""))
    counts = collections.Counter(finding.verdict for finding in findings)
    failed = sum(counts[verdict] for verdict in FAILURES)
    print(f"\n{len(findings)} artefacts: {', '.join(f'{count} {verdict}' for verdict, count in counts.items())}.")
    if counts["same bytes"] < len(findings):
        finite = [finding for finding in findings if finding.share < float("inf")]
        furthest = max(finite, key=operator.attrgetter("share"))
        largest = f"Largest deviation: {furthest.share:.2g} of what is allowed, {furthest.artefact}."
        print(largest if furthest.share else "No number deviates.")
        print("The reference comes from", *remarks)
    advice = "docs/verify.md says what to do"
    print(f"Not verified: {failed} outside tolerance, missing or unreadable; {advice}." if failed else "Verified.")
    return 1 if failed else 0


def bless(artefacts: list[Path], reference: Path) -> int:
    """Write copies and manifest anew, and remove what no artefact needs any more; the exit status."""
    missing = [str(artefact) for artefact in artefacts if not artefact.is_file()]
    if missing:
        print(f"{', '.join(missing)} missing: make all first; {reference} is as it was.", file=sys.stderr)
        return 1
    try:
        old = read_manifest(reference)[1]
    except (OSError, ValueError):
        old = {}
    sums = {str(artefact): provenance.checksum(artefact) for artefact in artefacts}
    texts = {artefact: copy for artefact in artefacts if (copy := copies.copy_of(artefact, reference))}
    manifest = reference / MANIFEST
    try:
        for artefact, copy in texts.items():
            copies.write_copy(artefact, copy)
        with replacing(manifest) as temporary:
            lines = [f"# {provenance.summary()}", *(f"{value}  {name}" for name, value in sums.items())]
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 1
    size, needed = 0, {*texts.values(), manifest, reference / "README.md"}
    for path in filter(Path.is_file, list(reference.rglob("*"))):
        if path in needed:
            size += path.stat().st_size
        else:
            path.unlink()
    changed = [name for name in sorted({*sums, *old}) if sums.get(name) != old.get(name)]
    news = f"{len(changed)} new or changed: {', '.join(changed) or 'none'}"
    print(f"{reference}: {len(sums)} artefacts, {size / 1e6:.2f} MB; {news}.")
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Command line; the exit status: 0, 1 (not verified), 2 (there is nothing to compare with)."""
    parser = argparse.ArgumentParser("python -m tras.paper.verification", description=__doc__.partition("\n")[0])
    parser.add_argument("artefacts", nargs="+", type=Path, help="files as make builds them")
    parser.add_argument("--reference", type=Path, default=Path("reference"), help="folder (default: %(default)s)")
    parser.add_argument("--bless", action="store_true", help="write the reference from these files")
    options = parser.parse_args(arguments)
    return (bless if options.bless else verify)(options.artefacts, options.reference)


if __name__ == "__main__":
    sys.exit(main())
