"""What make does when it is killed, when its files are damaged, and when the disk is full.

    .venv/bin/python benchmarks/faults.py [--params params/smoke.yaml] [--kills 20] [--seed 1] [--only kill damage disk]

Works in a temporary clone of this checkout with its own environment and prints a table; the exit status is 1 if
something was wrong. Smoke parameters take ten minutes. The part `disk` needs root, for a small file system in memory.
"""

import argparse
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PROFILE = "faults"
BUILD = Path("build") / PROFILE
STAGES = sorted(path.stem for path in (ROOT / "notebooks").glob("0*.ipynb"))
DAMAGES = ("truncated", "emptied", "a byte flipped", "a byte flipped, times put back", "deleted")


class Wrong(Exception):
    """What should not have happened."""


# --------------------------------------------------------------------------------------------------


def clone(folder, params):
    """This checkout as it is, uncommitted changes included, with a profile and an environment of its own."""
    subprocess.run(["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(folder)], check=True)
    command = ["git", "ls-files", "-z", "--modified", "--others", "--exclude-standard"]
    for name in filter(
        None, subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    ):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    os.chdir(folder)
    use_params(params.read_text())
    subprocess.run(["make", "setup"], check=True)


def use_params(text):
    Path("params", f"{PROFILE}.yaml").write_text(text)


def start():
    """`make all` as the leader of its own process group, output to a file."""
    log = open("make.log", "w")
    return subprocess.Popen(
        ["make", "all", f"PROFILE={PROFILE}"], stdout=log, stderr=subprocess.STDOUT, start_new_session=True
    )


def make():
    """`make all` to its end: (exit status, what it printed, seconds)."""
    began = time.monotonic()
    status = start().wait()
    return status, Path("make.log").read_text(), time.monotonic() - began


def artefacts():
    """Every file under a final name -> its checksum; what begins with a dot is temporary and counts elsewhere.

    The cache of 06_readings is no artefact: it may be deleted, and what is damaged in it is reported and computed again
    (tests/paper/test_grid.py).
    """
    files = [path for folder in ("data", "figures") for path in (BUILD / folder).rglob("*") if path.is_file()]
    files = [path for path in files if not path.name.startswith(".") and not {"provenance", "cache"} & set(path.parts)]
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def leftovers():
    """Temporary files that nobody removed."""
    return [str(path) for path in BUILD.rglob(".*") if path.is_file() and path.name != ".inputs"]


def processes():
    """Processes that work in this folder."""
    numbers = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if int(path.name) != os.getpid() and Path(os.readlink(path / "cwd")).is_relative_to(Path.cwd()):
                numbers.append(int(path.name))
        except OSError:
            pass
    return numbers


def check_complete(expected):
    """All artefacts have the expected bytes, every stage its stamp and a record that fits; no temporary files."""
    checksums = artefacts()
    wrong = sorted(name for name in {*checksums, *expected} if checksums.get(name) != expected.get(name))
    if wrong:
        raise Wrong(f"other bytes in {', '.join(wrong)}")
    for stage in STAGES:
        record = json.loads((BUILD / f"{stage}.json").read_text())
        json.loads((BUILD / f"{stage}.ipynb").read_text())
        for name, written in record["outputs"].items():
            path = Path(name)
            beside = json.loads((path.parent / "provenance" / f"{path.name}.json").read_text())
            if (
                not checksums[name] == written["sha256"] == beside["sha256"]
                or beside["parameters"] != record["parameters"]
            ):
                raise Wrong(f"the provenance of {name} is not its own")
    if leftovers():
        raise Wrong(f"left over: {', '.join(leftovers())}")


def check_whole(*allowed):
    """Whatever lies under a final name has the bytes of one complete run or the other: nothing is half written."""
    checksums = artefacts()
    odd = sorted(
        name for name, checksum in checksums.items() if checksum not in [expected.get(name) for expected in allowed]
    )
    if odd:
        copy = Path(tempfile.mkdtemp(prefix="tras-odd-"))
        shutil.copytree(BUILD, copy / "build")
        raise Wrong(
            f"of {len(checksums)} files these are of neither run: {', '.join(odd)}; all of them are kept in {copy}"
        )
    for stage in STAGES:
        if (BUILD / f"{stage}.ipynb").exists():
            json.loads((BUILD / f"{stage}.ipynb").read_text())


def finish(expected):
    """Run to the end, compare, and see that nothing is left to do; what make printed."""
    status, printed, _ = make()
    if status:
        raise Wrong(f"make ended with {status}: {printed[-500:]}")
    check_complete(expected)
    stamps = {stage: (BUILD / f"{stage}.ipynb").stat().st_mtime_ns for stage in STAGES}
    again, _, seconds = make()
    if again or stamps != {stage: (BUILD / f"{stage}.ipynb").stat().st_mtime_ns for stage in STAGES}:
        raise Wrong("make all once more was not a no-op")
    return printed, seconds


# --------------------------------------------------------------------------------------------------


def kill(number, rng, states, expected, other, seconds):
    """Kill make and its group at a random moment: from nothing, from another run's results, from a part of this one."""
    wait_for_orphans()
    kind = rng.choice(["nothing", "results of other parameters", "a part of the results"])
    shutil.rmtree(BUILD, ignore_errors=True)
    if kind != "nothing":
        shutil.copytree(states["other" if "other" in kind else "own"], BUILD)
    if kind == "a part of the results":
        for name in rng.sample(sorted(expected), rng.randint(1, 6)):
            Path(name).unlink()
    process, moment = start(), rng.uniform(0.0, seconds)
    try:
        process.wait(moment)
        where = "after its end"
    except subprocess.TimeoutExpired:
        while number % 2 == 0 and process.poll() is None and not leftovers():
            time.sleep(0.0005)  # every second time wait for a file that is being written
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        done = sum((BUILD / f"{stage}.ipynb").exists() for stage in STAGES)
        where = f"stages done: {done}, half-written temporary files: {len(leftovers())}"
    check_whole(expected, other)
    finish(expected)
    return f"{number:2}  from {kind}, after {moment:.1f} s, {where}"


def wait_for_orphans(seconds=10):
    """Nothing of a killed run may live on."""
    end = time.monotonic() + seconds
    while processes():
        if time.monotonic() > end:
            raise Wrong(f"processes outlived their make by {seconds} s: {processes()}")
        time.sleep(0.1)


def damage(name, how, rng, expected):
    """Damage one file: the next make must name it and make it again."""
    path = Path(name)
    status, content = path.stat(), bytearray(path.read_bytes())
    position = rng.randrange(len(content))
    if how == "deleted":
        path.unlink()
    elif how == "truncated":
        os.truncate(path, position)
    elif how == "emptied":
        os.truncate(path, 0)
    else:
        content[position] ^= 1 << rng.randrange(8)
        path.write_bytes(content)
    if "times" in how:
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    printed, _ = finish(expected)
    if name not in printed:
        raise Wrong(f"{name} {how}, and make did not name it: {printed[:300]}")
    return f"{name[len(str(BUILD)) + 1 :]} {how}: {next(line for line in printed.splitlines() if name in line)}"


def full_disk(size, expected):
    """Build on a file system of ``size`` bytes, then give it room."""
    shutil.rmtree(BUILD, ignore_errors=True)
    BUILD.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(BUILD)], check=True)
    try:
        status, printed, _ = make()
        if not status:
            raise Wrong(f"{size} bytes were enough")
        messages = [
            line
            for line in printed.splitlines()
            if re.search(r"(written \(|\[Errno 28\] )No space left on device.*(nothing was left|make room)", line)
        ]
        if not messages or "Traceback" in printed:
            raise Wrong(f"no clear sentence, but: {printed[-1500:]}")
        check_whole(expected)
        subprocess.run(["mount", "-o", "remount,size=1g", str(BUILD)], check=True)
        finish(expected)
        return f"{size / 1e6:.2f} MB: exit status {status}, {len(messages)} line(s): {messages[0][:150]}"
    finally:
        wait_for_orphans()
        subprocess.run(["umount", str(BUILD)], check=True)


# --------------------------------------------------------------------------------------------------


def baselines(params):
    """Two undisturbed runs: of other parameters, then of the given ones, both kept. Paths, checksums, seconds."""
    text, states, sums = params.read_text(), {}, {}
    changed = re.sub(
        r"^01_data_generation:\n",
        "01_data_generation:\n  train_seed: 7\n",
        re.sub(r"\n  train_seed:.*", "", text),
        flags=re.MULTILINE,
    )
    for name, content in (("other", changed), ("own", text)):
        use_params(content)
        shutil.rmtree(BUILD, ignore_errors=True)
        status, printed, seconds = make()
        if status:
            sys.exit(f"The undisturbed run failed:\n{printed}")
        sums[name], states[name] = artefacts(), Path("states") / name
        check_complete(sums[name])
        shutil.copytree(BUILD, states[name])
    differing = sum(sums["own"][name] != sums["other"][name] for name in sums["own"])
    print(
        f"Undisturbed: {seconds:.1f} s, {len(sums['own'])} artefacts, {differing} change with the parameters.\n",
        flush=True,
    )
    return states, sums["own"], sums["other"], seconds


def attempt(results, part, function, *arguments):
    """One test: a line printed, its outcome counted."""
    try:
        line, good = function(*arguments), True
    except Wrong as error:
        line, good = f"{arguments[0]}  WRONG: {error}", False
    print(f"{part:6}  {line}", flush=True)
    results.setdefault(part, []).append(good)


def chosen_damages(rng, expected, rounds):
    """One artefact of each stage with each kind of damage, as often as there are rounds."""
    outputs = [sorted(json.loads((BUILD / f"{stage}.json").read_text())["outputs"]) for stage in STAGES]
    return [(rng.choice(names), how) for _ in range(rounds) for names in outputs for how in DAMAGES]


def main():
    parser = argparse.ArgumentParser(description="Kill make, damage its files, fill its disk.")
    parser.add_argument(
        "--params", type=Path, default=ROOT / "params" / "smoke.yaml", help="parameters (default: the small ones)"
    )
    parser.add_argument("--kills", type=int, default=20, help="moments at which make is killed (default: %(default)s)")
    parser.add_argument(
        "--rounds", type=int, default=1, help="times that every stage has every damage (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=["kill", "damage", "disk"], default=["kill", "damage", "disk"])
    options = parser.parse_args()
    rng, results = random.Random(options.seed), {}
    params = options.params.resolve()
    with tempfile.TemporaryDirectory(prefix="tras-faults-") as folder:
        clone(Path(folder) / "clone", params)
        states, expected, other, seconds = baselines(params)
        if "kill" in options.only:
            for number in range(1, options.kills + 1):
                attempt(results, "kill", kill, number, rng, states, expected, other, seconds)
        if "damage" in options.only:
            wait_for_orphans()
            shutil.rmtree(BUILD, ignore_errors=True)
            shutil.copytree(states["own"], BUILD)
            for name, how in chosen_damages(rng, expected, options.rounds):
                attempt(results, "damage", damage, name, how, rng, expected)
        if "disk" in options.only and os.geteuid() == 0 and shutil.which("mount"):
            room = sum(path.stat().st_size for path in states["own"].rglob("*") if path.is_file())
            for share in (0.0, 0.05, 0.2, 0.5, 0.7, 0.85, 0.95):
                attempt(results, "disk", full_disk, max(4096, int(share * room)), expected)
        elif "disk" in options.only:
            print("disk    left out: only root can mount a small file system")
        os.chdir(ROOT)
    print("\npart    tests  wrong")
    for part, outcomes in results.items():
        print(f"{part:6}  {len(outcomes):5}  {outcomes.count(False):5}")
    return 0 if all(map(all, results.values())) else 1


if __name__ == "__main__":
    sys.exit(main())
