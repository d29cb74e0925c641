"""The lab as a user has it, in a real browser: in JupyterLab and as a page of its own, by keyboard and by mouse."""

import json
import re
import shutil
from pathlib import Path

import browser
import numpy as np
import pytest

from mireach import Polytope, lab

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
PIXEL = 0.05  # accuracy of what is drawn, in pixels of the picture


@pytest.fixture
def chromium():
    if browser.chromium() is None:
        pytest.skip("the browser tests were left out: there is no Chromium (on Debian: apt install chromium)")


@pytest.fixture
def tab(chromium):
    with browser.page() as tab:
        tab.set_default_timeout(60_000)
        yield tab


def lab_in_notebook(tab, address, index):
    """Scroll JupyterLab's notebook until lab number `index` is there."""
    tab.locator(".jp-Notebook").first.hover()
    labs = tab.locator(browser.LAB)
    for _ in range(400):
        if labs.count() > index:
            break
        tab.mouse.wheel(0, 250)
        tab.wait_for_timeout(100)
    labs.nth(index).scroll_into_view_if_needed()
    return labs.nth(index)


def settle(found):
    """Wait until no answer is on its way, and give the stamp of what is shown."""
    found.page.wait_for_function("lab => lab.dataset.busy !== 'true'", arg=found.element_handle())
    return int(found.get_attribute("data-stamp"))


def drawn(found, name):
    """The points of a set in the picture, in units of x: the corners of X say where a pixel is."""

    def points(kind):
        path = found.locator(f"svg.scene path.{kind}").first.get_attribute("d")
        return np.array(
            [[float(number) for number in pair.split(",")] for pair in re.findall(r"[-\d.]+,[-\d.]+", path)]
        )

    X, limits = points("state"), Polytope.box([-1, -1], [1, 1]).vertices()
    limits = limits * lab.subject(found.get_attribute("data-subject")).control("x1").high
    scale = np.ptp(limits, axis=0) / np.ptp(X, axis=0) * [1, -1]
    return limits[0] + (points(name) - X[0]) * scale


def assert_shows(found, settings):
    """The picture shows the sets that the library computes for these settings."""
    subject = lab.subject(found.get_attribute("data-subject"))
    look = lab.look(subject, settings)
    accuracy = PIXEL * 2 * subject.control("x1").high / 400
    for name, wanted in (("safe", look.safe.set), ("terminal", look.terminal and look.terminal.set)):
        assert (found.locator(f"svg.scene path.{name}").count() > 0) == (wanted is not None)
        if wanted is not None:
            np.testing.assert_allclose(drawn(found, name), wanted.vertices(), atol=accuracy)
    assert found.locator("svg.scene path.reach").count() == (look.terminal.steps if look.terminal else 0)
    assert found.locator("svg.scene path.earlier").count() == look.safe.iterations + 1
    return look


def use(tab, found, amount, kept):
    """Move the slider by keyboard and mouse, drag the start, mark a set, save: the lab must follow each time."""
    before = settle(found)
    assert_shows(found, {})
    slider, field = found.get_by_label(amount, exact=False).nth(0), found.get_by_label(amount, exact=False).nth(1)

    slider.focus()  # by keyboard
    step = float(slider.get_attribute("step"))
    begin = float(slider.input_value())
    for _ in range(6):
        tab.keyboard.press("ArrowRight")
    now = settle(found)
    assert now > before and float(field.input_value()) == pytest.approx(begin + 6 * step)
    assert_shows(found, {"amount": float(field.input_value())})

    box = slider.bounding_box()  # by mouse, to the very end and back
    middle = box["y"] + box["height"] / 2
    tab.mouse.move(box["x"] + 0.1 * box["width"], middle)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 2 * box["width"], middle, steps=40)
    settle(found)
    high = float(slider.get_attribute("max"))
    assert float(field.input_value()) == high
    assert assert_shows(found, {"amount": high}).safe.set is None
    assert found.locator(".verdict").inner_text().startswith("No F_max was found")
    assert found.locator("svg.scene path.witness").count() == 1
    tab.mouse.move(box["x"] + 0.14 * box["width"], middle, steps=40)
    tab.mouse.up()
    settle(found)
    value = float(field.input_value())
    assert 0 < value < high / 4
    assert_shows(found, {"amount": value})

    looks = settle(found)  # a hundred moves at once: only the first and the newest are looked at
    slider.evaluate(
        """(slider, count) => { for (let k = 1; k <= count; k++) {
            slider.value = slider.max * k / count / 2; slider.dispatchEvent(new Event('input')); } }""",
        100,
    )
    assert settle(found) - looks <= 3
    assert_shows(found, {"amount": float(field.input_value())})

    field.fill("-3")  # out of range: to the end
    field.press("Enter")
    settle(found)
    assert float(field.input_value()) == 0
    assert_shows(found, {"amount": 0})
    field.fill(str(begin))
    field.press("Enter")

    start = found.locator("circle.start")  # drag the initial state
    box = start.bounding_box()
    tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    tab.mouse.down()
    tab.mouse.move(box["x"] - 20, box["y"] + 60, steps=15)
    tab.mouse.up()
    settle(found)
    x = [float(found.get_by_label(f"initial state {name}").input_value()) for name in ("x₁", "x₂")]
    np.testing.assert_allclose(drawn(found, "nominal")[0], x, atol=0.03)
    start.focus()
    tab.keyboard.press("ArrowUp")
    settle(found)
    assert float(found.get_by_label("initial state x₂").input_value()) == pytest.approx(x[1] + 0.05)

    found.get_by_role("button", name="play").click()  # the sets one by one
    tab.wait_for_function("lab => lab.dataset.chosen === 'F0'", arg=found.element_handle())
    tab.wait_for_function("lab => lab.dataset.chosen === 'F1'", arg=found.element_handle())
    found.get_by_role("button", name="pause").click()
    found.get_by_label("set", exact=True).focus()
    tab.keyboard.press("End")
    assert found.get_attribute("data-chosen").startswith("R")

    found.get_by_label("maximal safe set").check()  # the layer
    found.locator("svg.scene path.maximal").wait_for(state="attached")
    found.get_by_label("maximal safe set").uncheck()
    assert found.locator("svg.scene path.maximal").count() == 0

    with tab.expect_download() as download:  # take it home
        found.get_by_role("button", name="Sets (JSON)").click()
    download.value.save_as(kept)
    saved = json.loads(kept.read_text())
    look = lab.look(lab.subject(found.get_attribute("data-subject")), saved["settings"])
    assert saved["settings"]["amount"] == begin and saved["safe_set"]["set"] == look.safe.set.to_dict()

    tab.wait_for_function("lab => lab.dataset.largest", arg=found.element_handle())  # filled in by itself
    largest = float(found.get_attribute("data-largest"))
    subject = lab.subject(found.get_attribute("data-subject"))
    assert lab.safe_set_at(subject, {}, largest) is not None


def use_views(tab, found):
    """Choose views of a loop with three states, move the section and the start: the lab must follow each time."""
    subject, accuracy = lab.subject(found.get_attribute("data-subject")), PIXEL * 20 / 400

    def assert_draws(**settings):
        tab.wait_for_function("lab => lab.dataset.pending === 'false'", arg=found.element_handle())
        settle(found)
        look = lab.look(subject, settings)
        for name, P in (("safe", look.safe.set), ("terminal", look.terminal.set)):
            np.testing.assert_allclose(drawn(found, name), look.view.polygon(P).vertices(), atol=accuracy)
        np.testing.assert_allclose(drawn(found, "nominal"), look.view.points(look.nominal), atol=accuracy)
        assert found.locator("svg.scene path.reach").count() == look.terminal.steps
        assert found.locator(".view").inner_text() == look.view.caption
        texts = found.locator("svg.scene text").all_text_contents()
        assert [text for text in texts if "x" in text] == [*look.view.names]

    found.scroll_into_view_if_needed()
    assert_draws()
    assert found.get_by_label("maximal safe set").count() == 0
    found.get_by_label("view", exact=True).select_option("section 1 3")
    found.get_by_label("initial state x₂").nth(1).fill("0.5")
    found.get_by_label("initial state x₂").nth(1).press("Enter")
    assert_draws(view="section 1 3", x2=0.5)
    start = found.locator("circle.start")  # x₁ and x₃ move, x₂ stays
    start.focus()
    tab.keyboard.press("ArrowUp")
    tab.keyboard.press("ArrowLeft")
    assert_draws(view="section 1 3", x1=4.95, x2=0.5, x3=0.05)
    assert start.get_attribute("aria-valuetext") == "x1 = 4.95, x2 = 0.5, x3 = 0.05"
    tab.wait_for_function("lab => lab.dataset.largest", arg=found.element_handle())
    found.get_by_label("disturbance bound").nth(1).fill("0.25")  # the terminal set follows, also when all else is done
    found.get_by_label("disturbance bound").nth(1).press("Enter")
    settle(found)
    assert_draws(view="section 1 3", amount=0.25, x1=4.95, x2=0.5, x3=0.05)
    found.get_by_label("initial state x₂").nth(1).fill("9")
    found.get_by_label("initial state x₂").nth(1).press("Enter")
    settle(found)
    tab.wait_for_function("lab => lab.textContent.includes('does not meet')", arg=found.element_handle())
    assert found.locator(".verdict.proven").count() == 1


def test_notebook_in_jupyterlab(tab, tmp_path):
    shutil.copy(NOTEBOOKS / "12_disturbance_lab.ipynb", tmp_path)
    with browser.jupyterlab(tmp_path) as address:
        browser.open_notebook(tab, address, "12_disturbance_lab.ipynb")
        use(tab, lab_in_notebook(tab, address, 0), "disturbance bound", tmp_path / "sets.json")


def test_page_of_its_own(tab, tmp_path):
    with browser.app(tmp_path) as address:
        tab.goto(address)
        labs = tab.locator(browser.LAB)
        labs.nth(1).wait_for()
        assert tab.get_by_text("What you will do").count() == 0
        use(tab, labs.nth(1), "times the proven error", tmp_path / "sets.json")
        use_views(tab, labs.nth(2))
