"""Execute notebooks and keep their outputs: python notebooks/build.py [NAME ...]

NAME is 01_sets_and_support_functions or a part of it; without a name all are built. The .py file (py:percent) is
what is edited; the .ipynb beside it is made here: executed from top to bottom, outputs kept, execution times and
counts of other machines left out.
"""

import sys
from pathlib import Path
from time import perf_counter

import jupytext
import nbformat
from nbclient import NotebookClient

from mireach.files import write_whole

FOLDER = Path(__file__).resolve().parent
CELL_TIMEOUT = 180  # seconds


def build(source):
    """Execute one .py notebook and write its .ipynb."""
    notebook = jupytext.read(source)
    notebook.metadata["kernelspec"] = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
    begin = perf_counter()
    NotebookClient(
        notebook, timeout=CELL_TIMEOUT, coalesce_streams=True, resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    seconds = perf_counter() - begin
    strip(notebook)
    write_whole(source.with_suffix(".ipynb"), nbformat.writes(notebook).rstrip("\n") + "\n")
    return seconds


def strip(notebook):
    """Remove what differs from run to run without saying anything: times, widget state, outputs on stderr."""
    notebook.metadata.pop("widgets", None)
    notebook.metadata.get("language_info", {}).pop("version", None)
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number:02d}"
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]


def main(names):
    sources = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
    chosen = [source for source in sources if not names or any(name in source.stem for name in names)]
    if not chosen:
        sys.exit(f"no notebook matches {names}; there are {[source.stem for source in sources]}")
    for source in chosen:
        print(f"{source.stem}: ", end="", flush=True)
        print(f"{build(source):.1f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
