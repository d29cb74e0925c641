"""Serve the disturbance lab as a page of its own, for a lecture: python notebooks/app.py [OPTIONS OF VOILA]

The page is notebook 12 without the cells that carry the tag "course". `--theme=dark` makes it dark, `--port=8866` says
where, `--no-browser` leaves the browser alone.
"""

import sys
from pathlib import Path

from traitlets.config import Config
from voila.app import Voila

NOTEBOOK = Path(__file__).with_name("12_disturbance_lab.ipynb")
COURSE = "course"  # tag of cells that only the notebook shows
LEFT_OUT = ["@jupyter/nbgrader"]  # extensions of JupyterLab that a page cannot hold


def without_course(_request, notebook, cwd):
    """The notebook with those cells only that make the page."""
    notebook.metadata["title"] = "Disturbance lab"
    notebook.cells = [cell for cell in notebook.cells if COURSE not in cell.metadata.get("tags", [])]
    return notebook


def main(options):
    config = Config()
    config.VoilaConfiguration.prelaunch_hook = without_course
    config.VoilaConfiguration.extension_denylist = LEFT_OUT
    Voila.launch_instance([str(NOTEBOOK), *options], config=config)


if __name__ == "__main__":
    main(sys.argv[1:])
