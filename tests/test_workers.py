"""Work in several processes: results, order, and that no worker outlives its parent."""

import os
import signal
import subprocess
import sys
import time

import pytest

from mireach.workers import in_parallel

pytest.importorskip("joblib")


def power(base, exponent):
    return base**exponent


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_order(jobs):
    assert list(in_parallel(power, [(k, 2) for k in range(7)], jobs)) == [k * k for k in range(7)]
    assert sorted(in_parallel(power, [(k, 2) for k in range(7)], jobs, ordered=False)) == [k * k for k in range(7)]


def test_one_job_stays_here_and_needs_no_joblib(monkeypatch):
    monkeypatch.setitem(sys.modules, "joblib", None)
    assert list(in_parallel(os.getpid, [()], 1)) == [os.getpid()]
    with pytest.raises(ImportError, match="jobs=1"):
        in_parallel(os.getpid, [()], 2)


@pytest.mark.skipif(os.name == "nt", reason="Windows does not tell a process that its parent ended")
@pytest.mark.parametrize("how", ["SIGKILL", "SIGTERM"])
def test_workers_end_when_their_parent_is_killed(tmp_path, how):
    script = f"""
import os, time
from mireach.workers import in_parallel

def wait(k):
    open(f"{tmp_path}/{{os.getpid()}}", "w").close()
    time.sleep(300)

list(in_parallel(wait, [(k,) for k in range(2)], 2))
"""
    parent = subprocess.Popen([sys.executable, "-c", script])
    try:
        deadline = time.monotonic() + 60
        while len(os.listdir(tmp_path)) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
        workers = [int(name) for name in os.listdir(tmp_path)]
        assert len(workers) == 2 and parent.pid not in workers
    finally:
        parent.send_signal(getattr(signal, how))
        parent.wait()
    deadline = time.monotonic() + 20
    while any(map(runs, workers)) and time.monotonic() < deadline:
        time.sleep(0.1)
    left = [pid for pid in workers if runs(pid)]
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left


def runs(pid):
    """Whether a process is there and is no zombie, which only waits for its exit status to be read."""
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except ProcessLookupError:
        return False
    except FileNotFoundError:
        return not os.path.isdir("/proc/self")
