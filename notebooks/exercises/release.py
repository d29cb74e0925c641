"""Make the students' copies of the exercises: python3 run.py exercises [exNN ...] [--force]

Writes notebooks/exercises/release/exNN/exNN.ipynb with nbgrader: the solutions are taken out, the checks are locked.
A copy that is there already may hold somebody's answers and is kept, unless --force is given.
"""

import argparse
import os
import sys
import sysconfig
import tempfile
from pathlib import Path

from nbgrader.apps.api import NbGraderAPI
from traitlets.config.loader import PyFileConfigLoader

COURSE = Path(__file__).resolve().parent


def course_api(folder, database):
    """nbgrader for a course folder with this course's settings.

    Parameters
    ----------
    folder : Path
        Holds source/; release/ and the like are made in it.
    database : Path
        Of nbgrader, an SQLite file; made if it is not there.

    Returns
    -------
    NbGraderAPI
    """
    os.environ["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])  # it runs alembic
    config = PyFileConfigLoader("nbgrader_config.py", path=str(COURSE)).load_config()
    config.CourseDirectory.root = str(folder)
    config.CourseDirectory.db_url = f"sqlite:///{Path(database).as_posix()}"
    return NbGraderAPI(config=config)


def release(names, force=False, course=COURSE):
    """Make the copies of the sets `names`; a failure ends the program with nbgrader's message.

    Parameters
    ----------
    names : sequence of str
    force : bool
        Whether to replace copies that are there.
    course : Path
        Holds source/, and release/ once a copy has been made.

    Returns
    -------
    list of Path
        The copies that were written.
    """
    written = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        api = course_api(course, Path(scratch) / "gradebook.db")
        for name in names:
            copy = course / "release" / name / f"{name}.ipynb"
            if copy.exists() and not force:
                print(f"{copy}: kept (--force replaces it)")
                continue
            answer = api.generate_assignment(name, force=True)
            if not answer["success"]:
                sys.exit(f"{name}: nbgrader failed\n{answer.get('error', '')}\n{answer['log']}")
            print(f"{copy}: written")
            written.append(copy)
    return written


def main(arguments):
    available = sorted(folder.name for folder in (COURSE / "source").glob("ex[0-9][0-9]"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="exNN", help=f"of {', '.join(available)}; all if none is given")
    parser.add_argument("--force", action="store_true", help="replace copies that exist, with the answers in them")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(available))
    if unknown:
        parser.error(f"there is no exercise {', '.join(unknown)}; choose from {', '.join(available)}")
    release(options.names or available, options.force)


if __name__ == "__main__":
    main(sys.argv[1:])
