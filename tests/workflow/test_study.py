"""Points of a study: each once, in order wherever it runs, kept as it is there, and gone on with."""

import io
import os
import sys

import pytest

from tras.workflow import executors
from tras.workflow.study import compute, each, terminal

POINTS = [{"k": k} for k in (3, 1, 2)]


def tenfold(calls, point):
    calls.append(point["k"])
    return {"value": 10 * point["k"], "missing": float("nan")}


def where(processes=1):
    return {"processes": processes, "progress": False}


def values(points):
    return [{"value": 10 * point["k"], "missing": None} for point in points]


@pytest.mark.parametrize("processes", [1, 2])
def test_values_are_in_the_order_of_the_points_and_the_dearest_is_begun_first(processes, tmp_path):
    calls = []
    result = compute(tenfold, POINTS, (calls,), folder=tmp_path, cost=lambda point: point["k"], **where(processes))
    assert result == (values(POINTS), {"computed": 3, "cached": 0})
    assert calls == ([3, 2, 1] if processes == 1 else [])
    assert each(pow, [(2, 3), (3, 2)], cost=lambda base, _: base, processes=processes) == [8, 9]


def test_what_is_kept_is_not_computed_again_and_its_shared_part_is_not_made(tmp_path):
    compute(tenfold, POINTS[:2], ([],), folder=tmp_path, code="one", **where())
    calls, missing = [], []

    def shared(points):
        missing.extend(points)
        return (calls,)

    result = compute(tenfold, POINTS, shared, folder=tmp_path, code="one", **where())
    assert result == (values(POINTS), {"computed": 1, "cached": 2}) and missing == POINTS[2:] and calls == [2]
    unused = lambda _: pytest.fail("nothing is missing")  # noqa: E731
    assert compute(tenfold, POINTS, unused, folder=tmp_path, code="one", **where())[1] == {"computed": 0, "cached": 3}
    assert compute(tenfold, POINTS, ([],), folder=tmp_path, code="two", **where())[1]["computed"] == 3
    assert compute(tenfold, POINTS, ([],), folder=tmp_path, kind="other", code="one", **where())[1]["computed"] == 3
    assert compute(tenfold, POINTS, ([],), **where()) == (values(POINTS), {"computed": 3, "cached": 0})  # kept nowhere


def test_only_what_a_killed_run_of_the_same_kind_was_writing_is_removed(tmp_path):
    for name in (".point-0.abc.json", ".other-0.abc.json"):
        (tmp_path / name).touch()
    compute(tenfold, POINTS, ([],), folder=tmp_path, **where())
    assert [path.name for path in tmp_path.glob(".*")] == [".other-0.abc.json"]


def test_an_interrupted_run_says_how_much_is_done_and_goes_on(tmp_path):
    def interrupted(point):
        if point["k"] == 2:
            raise KeyboardInterrupt
        return tenfold([], point)

    words = "interrupted; 2 of 3 points are done and "
    with pytest.raises(KeyboardInterrupt, match=f"{words}kept in .*: fit again to go on"):
        compute(interrupted, POINTS, folder=tmp_path, title="fit", **where())
    with pytest.raises(KeyboardInterrupt, match=f"{words}lost: give a cache to keep them"):
        compute(interrupted, POINTS, **where())
    assert compute(tenfold, POINTS, ([],), folder=tmp_path, **where())[1] == {"computed": 1, "cached": 2}


def test_a_point_that_is_lost_is_an_error_or_a_value_that_is_not_kept(tmp_path):
    def killing(point):
        if point["k"] == 1:
            os._exit(1)
        return tenfold([], point)

    words = "a job of 'fit' was lost: its process was killed 3 times .*; use fewer processes"
    with pytest.raises(executors.SchedulerError, match=words):
        compute(killing, POINTS, title="fit", **where(2))
    substitute = {"if_lost": lambda reason: {"lost": reason}, "keep": lambda value: "lost" not in value}
    result, counts = compute(killing, POINTS, folder=tmp_path, **substitute, **where(2))
    assert result[::2] == values(POINTS[::2]) and "killed" in result[1]["lost"] and counts["computed"] == 3
    assert compute(tenfold, POINTS, ([],), folder=tmp_path, **where())[1] == {"computed": 1, "cached": 2}


def test_the_bar_goes_where_it_is_sent():
    stream = io.StringIO()
    compute(tenfold, POINTS, ([],), title="fit", unit=" fits", **(where() | {"progress": stream}))
    assert "fit: 100%" in stream.getvalue() and "3/3" in stream.getvalue()
    with terminal() as bar:
        assert bar is None or bar.isatty() or bar is sys.stderr
