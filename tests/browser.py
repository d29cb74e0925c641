"""A headless Chromium and the servers that it looks at, for tests and benchmarks."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

APP = Path(__file__).resolve().parents[1] / "notebooks" / "app.py"
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
START = 60  # seconds that a server may take
KERNEL = 120_000  # milliseconds that a notebook may take to run
LAB = ".mireach-lab .columns"


def chromium():
    """Path of the system's Chromium, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def page(size=(1500, 1100), dark=False):
    """A page of a headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=FLAGS)
        try:
            scheme = "dark" if dark else "light"
            yield browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
        finally:
            browser.close()


@contextmanager
def server(folder, *command):
    """Run a server of Jupyter's family in `folder`, by a command of this Python; gives its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, *command, "--no-browser", f"--port={port}"]
    environment = {**os.environ, "JUPYTER_CONFIG_DIR": str(folder / "config"), "JUPYTER_DATA_DIR": str(folder / "data")}
    log = folder / "server.log"
    with log.open("w") as output:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield _answering(process, f"http://localhost:{port}/", log)
    finally:
        process.terminate()
        process.wait(timeout=20)


def jupyterlab(folder):
    """JupyterLab on a folder, without a token."""
    return server(folder, "-m", "jupyterlab", "--ServerApp.token=", "--allow-root")


def app(folder, *options):
    """The lab's own page, as `run.py app` serves it."""
    return server(folder, str(APP), *options)


def open_notebook(tab, address, name, dark=False):
    """Open a notebook in JupyterLab, run all of its cells, and wait for its labs."""
    tab.goto(f"{address}lab/tree/{name}?reset")
    tab.wait_for_selector(".jp-NotebookPanel-toolbar", timeout=KERNEL)
    if dark:
        menu(tab, "Settings", "Theme", "JupyterLab Dark")
    status = tab.locator("#jp-main-statusbar")
    status.get_by_text(re.compile(r"\| Idle$")).wait_for(timeout=KERNEL)
    menu(tab, "Run", "Run All Cells")
    status.get_by_text(re.compile(r"\| Busy$")).wait_for(timeout=KERNEL)
    status.get_by_text(re.compile(r"\| Idle$")).wait_for(timeout=KERNEL)


def menu(tab, *path):
    """Choose an entry of JupyterLab's menus."""
    tab.locator(".lm-MenuBar-item", has_text=re.compile(f"^{path[0]}$")).click()
    for entry in path[1:]:
        tab.locator(
            ".lm-Menu-item", has=tab.locator(".lm-Menu-itemLabel", has_text=re.compile(f"^{entry}$"))
        ).last.click()


def _answering(process, address, log):
    """The address, once the server answers there."""
    end = time.monotonic() + START
    while time.monotonic() < end and process.poll() is None:
        try:
            urlopen(address, timeout=5).close()
            return address
        except OSError:
            time.sleep(0.2)
    raise RuntimeError(f"the server did not start:\n{log.read_text()[-2000:]}")
