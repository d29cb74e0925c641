"""How fast the disturbance lab answers: python benchmarks/latency.py [--quick]

Two numbers per case, printed as a Markdown table. *Computation*: `lab.look`, for values of each slider over its whole
range, the other controls at random; for more than two states without the terminal set, which the page fills in when
nothing is moved, and with it in a row of its own. *On the screen*: from the input event of a slider to the frame after
the new picture, in JupyterLab in a headless Chromium (left out where there is none). Nothing here is asserted.
"""

import argparse
import sys
import tempfile
from itertools import product
from pathlib import Path
from time import perf_counter

import nbformat
import numpy as np

from mireach import lab

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import browser

MOVES = """
async (root) => {
  const slider = root.querySelector('.controls input[type=range]');
  const frame = () => new Promise(requestAnimationFrame);
  const waits = [];
  for (let k = 0; k < COUNT; k++) {
    const stamp = root.dataset.stamp, low = Number(slider.min), high = Number(slider.max);
    slider.value = low + (high - low) * ((k * 0.61803398875) % 1);
    const begin = performance.now();
    slider.dispatchEvent(new Event('input'));
    while (root.dataset.stamp === stamp) await frame();
    await frame();
    waits.push(performance.now() - begin);
    await new Promise((resolve) => setTimeout(resolve, 60));
  }
  return waits;
}
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the moves")
    count = 20 if parser.parse_args().quick else 200
    print("| lab | moves | median | 95th percentile | largest | unit |\n| --- | ---: | ---: | ---: | ---: | --- |")
    for name in ("pwa", "double_integrator", "three_tanks"):
        row(f"{name}: computation", computation(name, count, whole=not lab.subject(name).slow))
        if lab.subject(name).slow:
            row(f"{name}: computation with the terminal set", computation(name, count, whole=True))
        if browser.chromium():
            row(f"{name}: on the screen", on_the_screen(name, count))
    if not browser.chromium():
        print("\nNo Chromium was found: the time until the picture is on the screen was left out.")


def computation(name, count, whole):
    """Milliseconds of `lab.look`: each slider over its whole range, the rest at random."""
    subject, rng = lab.subject(name), np.random.default_rng(0)
    sliders = [control for control in subject.controls if control.slider and not control.choices]
    warm_up(subject)
    spent = []
    for control in sliders:
        for value in np.linspace(control.low, control.high, count // len(sliders) + 2):
            settings = {other.name: draw(other, rng) for other in subject.controls} | {control.name: float(value)}
            begin = perf_counter()
            lab.look(subject, settings, terminal=whole)
            spent.append(1e3 * (perf_counter() - begin))
    return spent


def warm_up(subject):
    """Build the cells of every network and fit, as the lab does in idle moments."""
    names = [name for name in ("network", "regions", "shape") if subject.control(name)]
    choices = [subject.control(name).values() for name in names]
    for chosen in product(*choices):
        lab.look(subject, dict(zip(names, chosen)) | {"centre": "equilibrium"})


def draw(control, rng):
    """A random value of a control."""
    return str(rng.choice(list(control.choices))) if control.choices else float(rng.uniform(control.low, control.high))


def on_the_screen(name, count):
    """Milliseconds from the slider's event to the frame after its picture, in JupyterLab."""
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(f"from mireach import lab\nlab.DisturbanceLab({name!r})")],
        metadata={"kernelspec": {"name": "python3", "display_name": "Python 3 (ipykernel)", "language": "python"}},
    )
    with tempfile.TemporaryDirectory() as folder:
        nbformat.write(notebook, Path(folder) / "lab.ipynb")
        with browser.jupyterlab(Path(folder)) as address, browser.page() as tab:
            browser.open_notebook(tab, address, "lab.ipynb")
            root = tab.locator(browser.LAB).first
            tab.wait_for_function("root => root.dataset.largest", arg=root.element_handle(), timeout=browser.KERNEL)
            tab.wait_for_timeout(20_000)  # the idle work: cells of the other networks and fits
            return root.evaluate(MOVES.replace("COUNT", str(count)))


def row(label, milliseconds):
    """Print one row."""
    middle, high, largest = np.percentile(milliseconds, [50, 95, 100])
    print(f"| {label} | {len(milliseconds)} | {middle:.0f} | {high:.0f} | {largest:.0f} | ms |", flush=True)


if __name__ == "__main__":
    main()
