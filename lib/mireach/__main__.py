"""python -m mireach TASK: what run.py runs after it has set up."""

import argparse
import sys
from collections.abc import Sequence

from .certificate import checker
from .engines.registry import ENGINES
from .errors import MireachError
from .studies.case_studies import NAMES, PAPER_NAMES


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one task; returns the exit status."""
    parser = argparse.ArgumentParser(prog="mireach", description=__doc__.split(":")[0])
    tasks = parser.add_subparsers(dest="task", required=True)
    quiet = argparse.ArgumentParser(add_help=False)
    quiet.add_argument("--quiet", action="store_true", help="no progress bars")

    task = tasks.add_parser("reproduce", parents=[quiet], help="the case studies: figures, report, table")
    task.add_argument("--results", default="results", help="folder of report.json and report.md")
    task.add_argument("--figures", default="docs/figures", help="folder of the figures")
    task.add_argument("--certificates", default="data", help="folder that gets CASE/certificate.json")
    task.add_argument("--engine", choices=list(ENGINES), help="default: cells")
    task.add_argument("--no-cross-check", action="store_true", help="leave out the comparison with the MILP")
    task.set_defaults(run=_reproduce)

    task = tasks.add_parser("train", parents=[quiet], help="make the data set and the network of a case from scratch")
    task.add_argument("case", choices=NAMES)
    task.add_argument("--seed", type=int, help="default: the seed whose network is shipped")
    task.add_argument("--output", help="folder; default: data/CASE of the checkout")
    task.set_defaults(run=_train)

    task = tasks.add_parser("seeds", parents=[quiet], help="train and analyse many networks, ship the best; resumes")
    task.add_argument("case", choices=PAPER_NAMES)
    task.add_argument("--count", type=int, default=50, help="number of seeds, counted from 0")
    task.add_argument("--jobs", type=int, default=-1, help="processes; -1 for all cores")
    task.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler, whose workers are used instead")
    task.add_argument("--analyse-only", action="store_true", help="train nothing: the maximal safe sets of the study")
    task.add_argument("--output", help="folder; default: data/CASE of the checkout")
    task.set_defaults(run=_seeds)

    task = tasks.add_parser("verify", parents=[checker.arguments(add_help=False)], help="check a certificate")
    task.set_defaults(run=checker.run)

    options = parser.parse_args(arguments)
    try:
        return options.run(options)
    except (MireachError, ValueError, OSError, ImportError) as error:
        print(f"mireach: {error}", file=sys.stderr)
        return 1


def _reproduce(options: argparse.Namespace) -> int:
    from .studies.report import reproduce

    check = None if options.no_cross_check else "milp"
    places = options.results, options.figures, options.certificates
    print(reproduce(*places, engine=options.engine, cross_check=check, progress=not options.quiet))
    written = f"{options.results}/report.md, {options.results}/report.json, {options.figures}/"
    print(f"written: {written}, {options.certificates}/CASE/certificate.json")
    return 0


def _train(options: argparse.Namespace) -> int:
    from .studies.seed_study import retrain

    print(retrain(options.case, options.seed, options.output, progress=not options.quiet))
    return 0


def _seeds(options: argparse.Namespace) -> int:
    from .studies.seed_study import make_study, reanalyse

    common = {"jobs": options.jobs, "folder": options.output, "progress": not options.quiet}
    if options.analyse_only:
        print(reanalyse(options.case, **common))
    else:
        print(make_study(options.case, options.count, scheduler=options.scheduler, **common))
    return 0


if __name__ == "__main__":
    sys.exit(main())
