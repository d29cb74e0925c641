"""How much memory a process has needed."""

from pathlib import Path


def peak():
    """Peak memory of this process in MiB, or None where the system does not tell.

    On Linux `resource.getrusage` would count the process from which this one was forked.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM")) / 1024
    try:
        import resource
    except ImportError:  # Windows has no such accounting
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # bytes on macOS
