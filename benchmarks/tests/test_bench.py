"""The harness of ``make bench``: limits, ratios, exponents, tables, what a child measures; no other package."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pytest

import tras
from benchmarks.bench import __main__ as command
from benchmarks.bench import children, data, environments, exact, figures, measure, report
from benchmarks.bench.children import Child, Failed
from benchmarks.bench.data import problems

# ----------------------------------------------------------------------------------------- children


@pytest.fixture
def child(tmp_path):
    """Start a child that runs the given lines for each request."""
    started = []

    def start(lines, memory=2**30, seconds=20.0):
        program = "import json, sys, time\nfor line in sys.stdin:\n" + "".join(
            f"    {text}\n" for text in lines.splitlines()
        )
        started.append(Child([sys.executable, "-c", program], tmp_path / "log", memory, seconds))
        return started[-1]

    yield start
    for one in started:
        one.end()
        assert not psutil.pid_exists(one.process.pid)


def test_a_child_answers_one_request_after_the_other(child):
    echo = child("print(json.dumps({'got': json.loads(line)}), flush=True)")
    assert [echo.ask({"do": k})["got"]["do"] for k in range(3)] == [0, 1, 2]


def test_a_child_beyond_its_memory_is_killed(child):
    hungry = child("held = [bytearray(b'x') * 2**25 for _ in iter(lambda: time.sleep(0.02), 1)]", memory=200 * 2**20)
    with pytest.raises(Failed, match="^out of memory$"):
        hungry.ask({})
    assert hungry.process.returncode == -9


def test_a_child_beyond_its_time_is_killed(child, monkeypatch):
    monkeypatch.setattr(children, "STALL", 1e6)  # CPU seconds decide
    busy = child(
        "begin = time.process_time()\nwhile time.process_time() < begin + 5: pass\nprint('{}', flush=True)", seconds=0.3
    )
    with pytest.raises(Failed, match="^over the time limit$"):
        busy.ask({})
    assert busy.process.returncode == -9


def test_a_child_that_waits_for_ever_is_killed_by_the_clock(child):
    with pytest.raises(Failed, match="^over the time limit$"):
        child("time.sleep(1000)", seconds=0.1).ask({})


def test_time_is_counted_from_the_request(child):
    slow = child(
        "begin = time.process_time()\nwhile time.process_time() < begin + 0.2: pass\nprint('{}', flush=True)",
        seconds=0.5,
    )
    assert [slow.ask({}) for _ in range(3)] == [{}] * 3


def test_a_child_that_ends_gives_its_last_words(child):
    with pytest.raises(Failed, match="ended with status 3: no cheese"):
        child("print('no cheese', file=sys.stderr, flush=True); sys.exit(3)").ask({})


def test_a_child_that_failed_says_so_and_goes_on(child):
    moody = child("print(json.dumps({'failed': 'rank 3'} if 'fit' in line else {}), flush=True)")
    with pytest.raises(Failed, match="^rank 3$"):
        moody.ask({"do": "fit"})
    assert moody.ask({"do": "other"}) == {}


# ----------------------------------------------------------------------------------------- problems


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return data.write(tmp_path_factory.mktemp("bench"), 1000, 28, runs=3, samples=20)


def test_the_functions_are_those_of_the_package(folder, tmp_path):
    problem = problems.read(folder)
    z = np.random.default_rng(5).uniform(-1, 1, (40, 6))
    assert np.allclose(problems.lift(problem, z), tras.Monomials(2)(z[:, :4], z[:, 4:]), rtol=1e-14)
    about, arrays = data.functions(20, width=0.7)
    gaussians = SimpleNamespace(**about, **arrays, functions=20)
    ours = tras.GaussianRBF(13, 0.7, centres=arrays["centres"])(z[:, :4], z[:, 4:])
    assert np.allclose(problems.lift(gaussians, z), ours, rtol=1e-12)


def test_pairs_stay_in_their_trajectory_and_hold_the_input(folder):
    problem = problems.read(folder)
    before, after = problems.pairs(problem)
    assert before.shape == after.shape == (1000, 6) and np.abs(problem.states).max() == 1
    assert np.array_equal(before[499], np.r_[problem.states[0, 499], problem.inputs[0, 499]])
    assert np.array_equal(after[499], np.r_[problem.states[0, 500], problem.inputs[0, 499]])
    assert np.array_equal(before[500, :4], problem.states[1, 0])


def test_functions_in_another_order_are_matched_and_others_refused(folder):
    problem = problems.read(folder)
    order = np.random.default_rng(0).permutation(28)
    shuffled = problem.values[:, order]
    assert np.array_equal(shuffled[:, problems.match(shuffled, problem.values)], problem.values)
    with pytest.raises(ValueError, match="function 3 is not among the 27"):
        problems.match(np.delete(problem.values, 3, axis=1), problem.values)


def test_pairs_are_whole_trajectories(tmp_path):
    with pytest.raises(ValueError, match="pairs is 750; give a multiple of 500"):
        data.write(tmp_path, 750, 28)


def test_extended_precision_against_householder(folder):
    problem = problems.read(folder)
    before, after = problems.pairs(problem)
    expected = np.linalg.lstsq(problems.lift(problem, before), after[:, :4], rcond=None)[0]
    solution = exact.refined(problem)
    assert exact.error(expected, solution) < 1e-10
    wrong = solution.copy()
    wrong[7, 2] += 1e-3 * np.abs(solution[:, 2]).max()
    assert exact.error(wrong, solution) == pytest.approx(1e-3)


def test_a_child_measures_fit_coefficients_and_roll_out(folder, tmp_path):
    bench = measure.Bench(tmp_path, measure.Limits(rounds=2), {}, {})
    rows = measure.measured(bench, measure.GRAM, folder, with_exact=True, rolled=True, compared=False)
    fit, rolled = rows["fit"], rows["roll-out"]
    assert fit["outcome"] == rolled["outcome"] == "" and fit["runs"] == rolled["runs"] == 2 and fit["targets"] == 28
    assert 0 < fit["cpu_least_s"] <= fit["cpu_s"] <= fit["cpu_most_s"] < 20
    problem, K = problems.read(folder), np.load(tmp_path / "found.npy")
    squared = np.linalg.cond(problems.lift(problem, problems.pairs(problem)[0])) ** 2
    assert 0 < fit["error"] < squared * np.finfo(float).eps  # what normal equations lose
    states = np.load(tmp_path / "rolled.npy")
    assert states.shape == (3, 20, 4) and (rolled["trajectories"], rolled["diverged"]) == (3, 0)
    first = problems.lift(problem, np.hstack([problem.x0, problem.u[:, 0]])) @ K
    assert np.array_equal(states[:, 0], problem.x0) and np.allclose(states[:, 1], first, rtol=1e-12)


def test_a_fit_beyond_the_memory_is_a_result(folder, tmp_path):
    bench = measure.Bench(tmp_path, measure.Limits(memory=2**20), {}, {})
    rows = measure.measured(bench, measure.GRAM, folder)
    assert rows == {"fit": {"outcome": "out of memory", "runs": 0}}


# --------------------------------------------------------------------------- times and their growth


@pytest.mark.parametrize("first, runs", [(0.1, 5), (12.0, 5), (12.1, 4), (29.0, 2), (31.0, 1), (500.0, 1)])
def test_number_of_runs(first, runs):
    assert measure.rounds(first, 60.0, 5) == runs


def test_ratios_are_of_runs_in_turn():
    runs = [{"cpu": c, "wall": 2 * c, "peak": p * 2**20} for c, p in ((1.0, 5), (8.0, 7), (3.0, 6))]
    others = [{"cpu": c, "wall": c, "peak": 0} for c in (2.0, 4.0, 1.0)]
    medians = measure.summary(runs, others)
    assert (medians["cpu_s"], medians["cpu_ratio"], medians["wall_ratio"]) == (
        3.0,
        2.0,
        4.0,
    )  # the median of ratios, not the ratio of medians (1.5)
    assert (medians["peak_mib"], medians["cpu_least_s"], medians["cpu_most_s"], medians["runs"]) == (7.0, 1.0, 8.0, 3)


def test_a_reference_that_fails_is_not_the_method_that_fails(tmp_path):
    def fails():
        raise Failed("out of memory")

    bench, run = measure.Bench(tmp_path, measure.Limits(), {}, {}), {"cpu": 1.0, "wall": 1.0, "peak": 1}
    assert measure.in_turn(bench, lambda: run, fails) == {
        "outcome": "no ratio, the reference failed: out of memory",
        "runs": 0,
    }
    assert measure.in_turn(bench, fails, lambda: run) == {"outcome": "out of memory", "runs": 0}


def test_what_was_too_large_is_not_tried_larger():
    row = {"what": "fit", "method": "pydmd", "pairs": 50_000, "functions": 506, "outcome": "out of memory"}
    method = measure.Method("pydmd", "with_pydmd")
    assert measure.hopeless([row], method, 500_000, 506) == "out of memory at 50000 pairs, 506 functions: not tried"
    assert measure.hopeless([row], method, 500_000, 210) is None
    assert measure.hopeless([row], measure.OURS, 500_000, 506) is None
    assert measure.hopeless([row | {"outcome": "ValueError: rank"}], method, 500_000, 506) is None


def test_exponent_of_a_power_law():
    x = np.geomspace(1, 1e3, 10)
    fit = report.exponent(x, 3 * x**1.7)
    assert fit["points"] == 4 and fit["exponent"] == pytest.approx(1.7) and fit["high"] - fit["low"] < 1e-9


def test_exponent_of_the_last_decade_only():
    x = np.geomspace(1, 1e3, 13)
    assert report.exponent(x, np.where(x < 100, 5.0, x**2))["exponent"] == pytest.approx(2.0)


def test_interval_of_an_exponent_holds_the_truth_as_often_as_it_says():
    rng, x = np.random.default_rng(0), np.geomspace(1, 9, 5)
    fits = [report.exponent(x, x * np.exp(0.1 * rng.standard_normal(5))) for _ in range(2000)]
    hits = np.mean([fit["low"] <= 1 <= fit["high"] for fit in fits])
    assert abs(hits - 0.95) < 0.015  # three standard deviations of the mean of 2000


@pytest.mark.parametrize(
    "x, y, words",
    [([1, 100], [1, 2], "1 points in the last decade"), ([1, 2], [0, 1], "must be positive"), ([], [], "0 points")],
)
def test_exponent_refuses(x, y, words):
    with pytest.raises(ValueError, match=words):
        report.exponent(x, y)


# ------------------------------------------------------------------------------- tables and figures


COMMON = {"outcome": "", "measured": "2026-01-02T03:04:05+00:00", "version": "1.0", "timed": "lift + fit", "runs": 5}


@pytest.fixture
def compared():
    rows = []
    for pairs in (50_000, 500_000):
        for count in (28, 506):
            about = COMMON | {"what": "fit", "pairs": pairs, "functions": count}
            rows.append(about | {"method": "tras", "cpu_s": 0.25, "cpu_ratio": 1.0, "peak_mib": 12.4, "error": 3e-16})
            rows.append(
                about
                | {"method": "deeptime", "cpu_s": 1.0, "cpu_ratio": 4.0, "peak_mib": 90.0, "error": 2e-9, "runs": 2}
            )
    rows[-1] |= {"outcome": "out of memory at 50000 pairs, 506 functions: not tried"} | dict.fromkeys(
        ("cpu_s", "cpu_ratio", "peak_mib", "error"), np.nan
    )
    rows[-2] |= {"outcome": "ValueError: rank 3"}
    for method, ratio in (("tras, one step", 0.3), ("plain Gram", 1.0), ("deeptime", 2.0)):
        about = COMMON | {
            "what": "roll-out",
            "pairs": 50_000,
            "functions": 84,
            "trajectories": 100,
            "diverged": 7 * (method == "deeptime"),
        }
        rows.append(about | {"method": method, "cpu_s": ratio, "cpu_ratio": ratio, "peak_mib": 1.0})
    return pd.DataFrame(rows)


@pytest.fixture
def grown():
    rows = []
    for k in range(1, 9):
        fit = COMMON | {"variant": "koopman_matrix", "pairs": 50_000, "functions": 84, "trajectories": 100}
        rows.append(fit | {"against": "pairs", "pairs": 1000 * 2**k, "cpu_s": 0.01 * 2**k, "peak_mib": 14.0})
        rows.append(
            fit | {"against": "functions", "functions": 20 * 2**k, "cpu_s": 0.01 * 4**k, "peak_mib": 3.0 * 4**k}
        )
        rows.append(
            fit
            | {
                "against": "trajectories",
                "variant": "one_step",
                "trajectories": 3**k,
                "cpu_s": 0.1 * 3**k,
                "peak_mib": 1.0,
            }
        )
    return pd.DataFrame(rows)


def test_tables_say_what_was_measured(compared, grown, tmp_path):
    report.write(tmp_path, compared, grown)
    text = report.text(tmp_path)
    assert report.processor() in text and "on 2026-01-02" in text
    assert "| tras | 0.25 s | 0.25 s |" in text and "| deeptime | 4x (2 runs) | out of memory |" in text
    assert "| tras | 0.25 s | failed |" in text and "* tras, 500 000 pairs, N = 506: ValueError: rank 3" in text
    assert "| tras | 12 | 12 |" in text and "| deeptime | 2e-09 | 2e-09 |" in text
    assert "| deeptime | 84 | 2 s | 2x | lift + fit, 7 of 100 diverge |" in text
    assert (
        "| fit time | pairs | koopman matrix | 1 | 1.00 |" in text
        and "| memory | pairs | koopman matrix | 0 | 0.00 |" in text
    )
    assert (
        "| fit time | functions | koopman matrix | 2 | 2.00 |" in text
        and "| roll-out time | trajectories | one step | 1 | 1.00 |" in text
    )
    assert set(pd.read_csv(tmp_path / "peers.csv")["processor"]) == {report.processor()}


def test_growth_of_which_nothing_was_measured_is_left_out(compared, grown, tmp_path):
    """As after ``--kept`` before any growth was measured."""
    report.write(
        tmp_path,
        compared,
        pd.DataFrame(
            [
                {
                    "against": "pairs",
                    "variant": "koopman_matrix",
                    "pairs": 1000,
                    "functions": 84,
                    "outcome": "not measured",
                    "runs": 0,
                }
            ]
        ),
    )
    assert "How our cost grows" not in report.text(tmp_path) and "**Fit" in report.text(tmp_path)
    report.draw(tmp_path)
    assert not (tmp_path / "growth.png").exists() and (tmp_path / "peers.png").exists()


def test_what_all_processors_gain_is_told_by_the_clock_and_the_floor_by_multiples(compared, tmp_path):
    ours = compared[(compared["method"] == "tras") & (compared["what"] == "fit")].iloc[[0]]
    rows = [
        ours.assign(method="floor", cpu_ratio=0.5),
        ours.assign(method=report.ALL_PROCESSORS, cpu_ratio=1.1, wall_ratio=0.57),
    ]
    report.write(tmp_path, pd.concat([compared, *rows]), None)
    assert f"Ours over the floor: 2.00 at N = {ours['functions'].iloc[0]}." in report.text(tmp_path)
    assert "| tras, all processors | 0.57x by the clock" in report.text(tmp_path)


def test_tables_go_between_their_markers(compared, tmp_path):
    report.write(tmp_path, compared, None)
    page = tmp_path / "page.md"
    page.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    report.publish(tmp_path, page)
    assert page.read_text().startswith(f"before\n{report.BEGIN}\nMeasured") and page.read_text().endswith(
        f"|\n{report.END}\nafter\n"
    )
    assert "old" not in page.read_text()


def test_figures_show_every_method_and_slope(compared, grown, tmp_path):
    report.write(tmp_path, compared, grown)
    report.draw(tmp_path)
    for stem in ("peers", "growth"):
        assert all((tmp_path / f"{stem}.{suffix}").stat().st_size > 1000 for suffix in ("png", "svg", "pdf", "csv"))
    drawn = figures.peers_figure(report.read(tmp_path, "peers.csv"))
    lines = {line.get_label(): line for line in drawn.axes[1].get_lines()}
    assert set(lines) == {"tras", "deeptime"} and list(lines["deeptime"].get_xdata()) == [28]  # 506 was out of memory
    drawn = figures.growth_figure(report.read(tmp_path, "growth.csv"), report.read(tmp_path, "growth_exponents.csv"))
    labels = [line.get_label() for axes in drawn.axes for line in axes.get_lines()]
    assert sum(label.startswith("theory") for label in labels) == 4 and any(
        "exponent 2.00" in label for label in labels
    )


# ----------------------------------------------------------------------- environments, command line


def test_every_peer_is_locked_with_hashes_and_no_address():
    for name in command.PEERS:
        text = (environments.PEERS / f"{name}.txt").read_text()
        pinned = [line for line in text.splitlines() if line and not line.startswith((" ", "#"))]
        requirement = (environments.PEERS / f"{name}.in").read_text().split()[0]
        assert any(line.lower().startswith(requirement.lower()) for line in pinned) and "://" not in text
        assert all(line.endswith("\\") for line in pinned) and text.count("--hash=sha256:") >= len(pinned)


def test_an_environment_that_cannot_be_made_is_one_sentence(tmp_path):
    asked = []

    def run(arguments, **options):
        asked.append(arguments)
        return SimpleNamespace(returncode="install" in arguments, stdout="", stderr="\nno space left\nmore\n")

    with pytest.raises(RuntimeError, match="^the environment of deeptime could not be made: no space left$"):
        environments.interpreter("deeptime", tmp_path, run)
    assert "--require-hashes" in asked[-1] and not list(tmp_path.glob("deeptime/.ready*"))
    with pytest.raises(RuntimeError, match="no lock file einstein.txt for a peer 'einstein'; known are datafold"):
        environments.interpreter("einstein", tmp_path, run)


def test_an_environment_is_made_once_for_a_lock(tmp_path):
    asked = []

    def run(arguments, **options):
        asked.append(arguments)
        (tmp_path / "deeptime" / "bin").mkdir(parents=True, exist_ok=True)
        (tmp_path / "deeptime" / "bin" / "python").touch()
        return SimpleNamespace(returncode=0, stdout="", stderr="")

    for _ in range(2):
        assert environments.interpreter("deeptime", tmp_path, run) == tmp_path / "deeptime" / "bin" / "python"
    assert len(asked) == 2
    for stamp in (tmp_path / "deeptime").glob(".ready-*"):
        stamp.rename(stamp.with_name(".ready-of-another-lock"))
    environments.interpreter("deeptime", tmp_path, run)
    assert len(asked) == 4


def test_a_peer_without_environment_is_reported_and_the_rest_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(measure.data, "write", lambda *arguments, **options: tmp_path)
    monkeypatch.setattr(
        measure, "measured", lambda bench, method, problem, **options: {"fit": {"outcome": "", "runs": 1, "cpu_s": 1.0}}
    )
    bench = measure.Bench(
        tmp_path, measure.Limits(), {}, {"pykoop": "the environment of pykoop could not be made: no space left"}
    )
    methods = [measure.OURS, measure.Method("pykoop", "with_pykoop", "", "pykoop")]
    rows = measure.compare(bench, methods, [(1000, 28)], [], lambda text: None)
    assert [row["outcome"] for row in rows] == ["", "the environment of pykoop could not be made: no space left"]
    files = list((tmp_path / "measured").glob("*.json"))
    assert len(files) == 1 and json.loads(files[0].read_text())["fit"]["cpu_s"] == 1.0
    monkeypatch.setattr(measure, "measured", lambda *arguments, **options: pytest.fail("was measured before"))
    assert len(measure.compare(bench, methods, [(1000, 28)], [], lambda text: None)) == 2


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--peers", "einstein"], "no peer 'einstein'; choose from pykoop, "),
        (["--pairs", "1234"], "--pairs 1234: give multiples of 500"),
        (["--functions", "9"], "--functions 9: give 7, 28, 84"),
        (["--memory", "0"], "--memory 0: give a positive number"),
        (["--runs", "-1"], "--runs -1: give a positive number"),
    ],
)
def test_bad_options_are_one_sentence(arguments, words, capsys):
    with pytest.raises(SystemExit) as caught:
        command.main(arguments)
    assert caught.value.code == 2 and words in capsys.readouterr().err


def test_make_bench_and_its_help(capsys):
    with pytest.raises(SystemExit) as caught:
        command.main(["--help"])
    assert caught.value.code == 0 and "--peers" in capsys.readouterr().out
    assert "-m benchmarks.bench $(BENCH)" in (measure.ROOT / "Makefile").read_text()
