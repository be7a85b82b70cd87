"""Jobs done somewhere: every result once, workers that are killed, jobs that kill them all, schedulers that fail.

The jobs import nothing of the package, so that the processes start quickly.
"""

import os
import signal
import socket
import subprocess
import sys
import threading
import time

import psutil
import pytest

from tras.workflow import executors
from tras.workflow.executors import Lost, SchedulerError

JOBS = [(k,) for k in range(6)]


@pytest.fixture(params=["processes", "dask"])
def elsewhere(request, cluster):
    return {"scheduler": cluster.scheduler_address if request.param == "dask" else "processes", "processes": 2}


@pytest.fixture(params=["here", "processes", "dask"])
def anywhere(request, cluster):
    schedulers = {"here": None, "processes": "processes", "dask": cluster.scheduler_address}
    return {"scheduler": schedulers[request.param], "processes": 2}


def square():
    """A function that travels by value."""

    def work(offset, k):
        import time

        time.sleep(0.05 * (k == 0))  # the first is the last to be done
        return offset + k * k

    return work


def killing(marker, job, forever=False):
    def work(k):
        if k == job and (forever or not marker.exists()):
            marker.write_text("killed")
            os.kill(os.getpid(), signal.SIGKILL)
        return k * k

    return work


def test_every_result_is_given_once_and_in_order_if_asked(anywhere):
    expected = [(k, 10 + k * k) for k in range(6)]
    assert sorted(executors.run(square(), JOBS, (10,), **anywhere)) == expected
    assert list(executors.run(square(), JOBS, (10,), ordered=True, **anywhere)) == expected
    assert list(executors.run(square(), [], (10,), **anywhere)) == []


@pytest.mark.slow
def test_a_killed_worker_costs_time_only(elsewhere, tmp_path):
    assert sorted(executors.run(killing(tmp_path / "marker", 2), JOBS, **elsewhere)) == [(k, k * k) for k in range(6)]
    assert (tmp_path / "marker").exists()


@pytest.mark.slow
def test_a_job_that_kills_every_worker_is_lost_and_the_others_are_done(elsewhere, cluster, tmp_path):
    allowed, cluster.scheduler.allowed_failures = cluster.scheduler.allowed_failures, 0  # for speed
    try:
        results = dict(executors.run(killing(tmp_path / "marker", 2, forever=True), JOBS, **elsewhere))
    finally:
        cluster.scheduler.allowed_failures = allowed
    assert isinstance(results.pop(2), Lost) and results == {k: k * k for k in range(6) if k != 2}


def test_what_a_job_raises_is_raised_here(anywhere):
    def work(k):
        if k == 3:
            raise ValueError("three is no job")
        return k

    with pytest.raises(ValueError, match="three is no job"):
        list(executors.run(work, JOBS, **anywhere))
    results = sorted(executors.run(square(), JOBS[:2], (0,), **anywhere))
    assert results == [(0, 0), (1, 1)]  # and the next run is not disturbed


def test_who_stops_asking_stops_the_work(elsewhere, tmp_path):
    def work(k):
        import time

        time.sleep(0.2)
        (tmp_path / str(k)).touch()

    results = executors.run(work, [(k,) for k in range(40)], **elsewhere)
    next(results)
    results.close()
    assert len(list(tmp_path.iterdir())) < 10


def test_an_interrupted_run_leaves_no_process_at_work(tmp_path):
    def work(k):
        import os
        import time

        (tmp_path / str(os.getpid())).touch()
        time.sleep(60 * k)

    results = executors.run(work, [(0,), (1,), (1,)], scheduler="processes", processes=2)
    next(results)
    results.close()
    for _ in range(200):
        if not any(psutil.pid_exists(int(path.name)) for path in tmp_path.iterdir()):
            break
        time.sleep(0.05)
    assert list(tmp_path.iterdir()) and not any(psutil.pid_exists(int(path.name)) for path in tmp_path.iterdir())


def test_the_scheduler_looks_for_workers_that_differ(cluster):
    def alike():
        import os

        return {"place": str(os.getpid())}

    words = f"worker tcp://.* has place .* but {os.getpid()} is needed; install environment.txt there"
    with pytest.raises(SchedulerError, match=words):
        list(executors.run(square(), JOBS, (0,), scheduler=cluster.scheduler_address, alike=alike))


def test_a_worker_that_comes_later_is_compared_too(cluster, monkeypatch):
    monkeypatch.setattr(executors, "_require_alike", lambda *_: None)
    with pytest.raises(SchedulerError, match="worker tcp://.* has version 1 but 2 is needed"):
        list(executors.run(square(), JOBS, (0,), scheduler=cluster.scheduler_address, alike=differing("2", "1")))


def differing(here, there):
    pid = os.getpid()
    return lambda: {"version": here if os.getpid() == pid else there}


def test_a_worker_without_the_package_is_named(cluster):
    def alike():
        import os

        if os.getpid() != pid:
            raise ModuleNotFoundError("No module named 'tras'")
        return {}

    pid = os.getpid()
    words = "cannot import tras .No module named 'tras'.; install environment.txt and this package there"
    with pytest.raises(SchedulerError, match=f"worker tcp://.* {words}"):
        list(executors.run(square(), JOBS, (0,), scheduler=cluster.scheduler_address, alike=alike))


def test_a_scheduler_without_workers_is_named(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(executors, "_PATIENCE", 0.5)
    with LocalCluster(n_workers=0, dashboard_address=":0", processes=False, protocol="tcp") as empty:
        with pytest.raises(SchedulerError, match="has no worker; start some"):
            list(executors.run(square(), JOBS, (0,), scheduler=empty.scheduler_address))


def test_a_scheduler_that_goes_away_is_named(monkeypatch):
    from distributed import LocalCluster

    options = {"threads_per_worker": 1, "dashboard_address": ":0", "processes": False, "protocol": "tcp"}
    with LocalCluster(n_workers=1, **options) as cluster:
        results = executors.run(square(), [(k,) for k in range(40)], (0,), scheduler=cluster.scheduler_address)
        next(results)
        cluster.close()
        with pytest.raises(SchedulerError, match="went away; start it again"):
            list(results)


def test_another_kind_of_server_is_no_scheduler(monkeypatch):
    """One that never answers, as a web server that waits for a request."""
    monkeypatch.setattr(executors, "_PATIENCE", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:
        accepted = []
        thread = threading.Thread(target=lambda: accepted.append(server.accept()))
        thread.start()
        words = "cannot be reached within 0.3 s; start one .docs/scale.md., or give another address"
        with pytest.raises(SchedulerError, match=words):
            list(executors.run(square(), JOBS, (0,), scheduler=f"tcp://127.0.0.1:{server.getsockname()[1]}"))
        thread.join()
        accepted[0][0].close()


@pytest.mark.parametrize("scheduler", ["cluster", 8786, ("tcp", "host")])
def test_what_is_no_scheduler_is_refused(scheduler):
    words = "scheduler is .*; give None, 'processes', or an address such as 'tcp://host:8786'"
    with pytest.raises(ValueError, match=words):
        list(executors.run(square(), JOBS, scheduler=scheduler))


def test_the_pool_that_joblib_shares_is_left_alone():
    from joblib import Parallel, delayed

    for _ in range(2):
        assert dict(executors.run(pow, [(2, 3), (3, 2)], scheduler="processes", processes=2)) == {0: 8, 1: 9}
        assert Parallel(n_jobs=2)(delayed(pow)(k, 2) for k in (1, 2, 3)) == [1, 4, 9]


def test_a_script_needs_no_guard_and_its_functions_travel_by_value(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from tras.workflow import executors\n"
        "print('once')\n"
        "def half(k): return k / 2\n"
        "print(list(executors.run(half, [(1,), (3,)], scheduler='processes', processes=2, ordered=True)))\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment, timeout=120)
    assert run.stdout.splitlines() == ["once", "[(0, 0.5), (1, 1.5)]"] and not run.stderr


def test_processes_serve_the_next_run():
    def pids(count):
        return {pid for _, pid in executors.run(os.getpid, [()] * 8, scheduler="processes", processes=count)}

    first = pids(1)
    assert pids(1) == first and os.getpid() not in first


@pytest.mark.parametrize("processes", [0, -1, 1.5, True])
def test_a_number_of_processes_that_is_none_is_refused(processes):
    with pytest.raises(ValueError, match="processes is .*; give a whole number, 1 or more, or None for one per core"):
        list(executors.run(square(), JOBS, scheduler="processes", processes=processes))
