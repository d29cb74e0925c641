"""Side-by-side timings, printed as Markdown tables: python3 run.py bench [PART ...]

The parts are "rooms" (each engine and each computation by itself), "peers" (against other solvers), "wide" (cells
of a large network), "growth" and "dimensions"; the last table says which targets were reached. Medians of several
runs in one process on one machine; whole-process figures are of a child process. Nothing here is asserted, since
times depend on the machine.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import highspy
import numba
import numpy as np
import peers
from growth import seconds

import mireach as mr
from mireach import case_studies
from mireach.analysis import maximal_set
from mireach.analysis.plane import PlanarLoop
from mireach.engines import cells, exact_cells
from mireach.engines.exact import Exact

PARTS = ("rooms", "peers", "wide", "growth", "dimensions")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; default: all")
    parts = parser.parse_args().parts or PARTS
    if unknown := set(parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(unknown)}; choose of {', '.join(PARTS)}")
    print(f"Python {platform.python_version()}, numpy {np.__version__}, numba {numba.__version__},", end=" ")
    print(f"HiGHS {highspy.Highs().version()}, {platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    reached = []
    if "rooms" in parts:
        print("\n## Single computations\n\n| work | median | unit | runs |\n| --- | ---: | --- | ---: |")
        for name in ("pwa", "double_integrator"):
            for_case(name)
        for name in case_studies.NAMES:
            for_certificate(name)
        whole_process()
    if "peers" in parts:
        print("\n## Against other solvers\n")
        reached += peers.main([])
    if "wide" in parts:
        reached += child("growth.py", "--wide")
    if "growth" in parts:
        print("\n## Growth\n", flush=True)
        child("growth.py")
    if "dimensions" in parts:
        print("\n## More than two states\n", flush=True)
        child("dimensions.py", "--growth")
    if reached:
        print("\n## Targets\n\n| work | compared with | target | measured | reached |", end="")
        print("\n| --- | --- | ---: | ---: | --- |")
        for line in reached:
            print(f"| {' | '.join(line)} |")


def child(script, *options):
    """Run a script of this folder as a process of its own; the rows that it marks for the last table."""
    command = [sys.executable, str(Path(__file__).parent / script), *options]
    lines = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    print("\n".join(line for line in lines if not line.startswith(peers.MARK)), flush=True)
    return [line.split("\t")[1:] for line in lines if line.startswith(peers.MARK)]


def for_case(name):
    """Cells and MILP of one case study."""
    case = mr.case_study(name)
    safe, terminal = sets_of(case)
    X, C = case.system.state_set, case.directions
    count = len(cells.cells(case.loop))
    row(f"{name}: build the cells ({count})", lambda: cells.cells(fresh(case)), 1e3, "ms", 20)
    row(f"{name}: one step, 8 directions over X, cells", lambda: mr.support(case.loop, X, C), 1e3, "ms", 200)
    row(
        f"{name}: cells, F_max ({safe.iterations}) and terminal set ({terminal.steps})",
        lambda: sets_of(case, True),
        1e3,
        "ms",
        10,
    )
    for_region(name, case)
    for label, F in (("X", X), ("F_max", safe.set), ("the terminal set", terminal.set)):
        row(
            f"{name}: one step, 8 directions over {label}, MILP",
            lambda F=F: mr.support(case.loop, F, C, engine="milp"),
            1,
            "s",
            3,
        )


def for_region(name, case):
    """The maximal safe set, from the cells to the float region, its outer bound, its proof; and the attractor."""
    plane, found = PlanarLoop.of(case.loop), mr.maximal_safe_set(case.loop, prove=False)
    slack = maximal_set.SLACK * np.abs(plane.state_set.bounding_box()).max()
    for label, sign in (("maximal safe set", 1), ("its outer bound", -1)):
        row(
            f"{name}: {label} ({found.iterations}), from the cells",
            lambda sign=sign: maximal_set._shrink(plane, sign * slack, maximal_set.MOST_ITERATIONS),
            1e3,
            "ms",
            20,
        )
    row(f"{name}: exact cells", lambda: exact_cells.cells(fresh(case)), 1, "s", 3)
    X, C = case.system.state_set, case.directions
    row(f"{name}: one step, 8 directions over X, exact", lambda: Exact().support(case.loop, X, C), 1e3, "ms", 10)
    row(
        f"{name}: rational proof ({len(found.set.pieces)} pieces)",
        lambda: mr.prove_rpi(case.loop, found.set),
        1,
        "s",
        3,
    )
    steps = mr.attractor(case.loop, found).steps
    row(f"{name}: attractor ({steps} steps)", lambda: mr.attractor(case.loop, found), 1, "s", 3)


def for_certificate(name):
    """The certificate of one case study, made and verified."""
    case, file = mr.case_study(name), case_studies.data_file(name, "certificate.json")
    safe, terminal = sets_of(case)
    label = f"{name}: certificate of {len(terminal.history)} sets, made"
    row(label, lambda: mr.certificate.make(case.loop, safe, terminal, plant=case.plant), 1, "s", 3)
    row(
        f"{name}: the same, verified ({file.stat().st_size // 1000} kB)", lambda: mr.certificate.verify(file), 1, "s", 3
    )


def fresh(case):
    """The loop of a case with a copy of its network, so that nothing is cached."""
    return mr.ClosedLoop(case.system, mr.MaxoutNetwork.from_dict(case.network.to_dict()))


def sets_of(case, anew=False):
    """Safe set and terminal set of a case, from its cells."""
    loop = fresh(case) if anew else case.loop
    safe = mr.safe_set(loop, case.safe_directions)
    return safe, mr.terminal_set(loop, safe, case.directions, case.epsilon)


def row(label, work, factor, unit, runs):
    """Print the median time of `work`."""
    print(f"| {label} | {seconds(work, runs) * factor:.3g} | {unit} | {runs} |", flush=True)


def whole_process():
    """`reproduce`, cross-check included, as a process of its own: seconds and peak memory."""
    with tempfile.TemporaryDirectory() as folder:
        code = "import sys, memory; from mireach.__main__ import main; main(sys.argv[1:]); print(memory.peak())"
        command = [sys.executable, "-c", code, "reproduce", "--quiet"]
        command += [part for name in ("results", "figures", "certificates") for part in (f"--{name}", folder)]
        begin = perf_counter()
        here = Path(__file__).parent
        said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=here).stdout
        took = perf_counter() - begin
    print(f"| reproduce, whole process | {took:.3g} | s | 1 |")
    needed = said.split()[-1]
    if needed != "None":
        print(f"| reproduce, peak memory | {float(needed):.0f} | MiB | 1 |")


if __name__ == "__main__":
    main()
