"""The explorer as its user has it: JupyterLab in chromium, opened as `make lab` does, driven by mouse and menus."""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, make_files

pytestmark = pytest.mark.slow
PATIENCE = 60_000  # ms: a busy machine is slow, not wrong


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """What JupyterLab needs of the project, in a folder that it may write to: it saves notebooks by itself."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("notebooks", "params", "tras", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".ipynb_checkpoints"))
    make_files(folder)
    (folder / ".venv").symlink_to(sys.prefix)
    return folder


@pytest.fixture(scope="module")
def page(browser, checkout):
    """The page that `make lab` opens, all cells run."""
    folders = {"CONFIG_DIR": "config", "DATA_DIR": "share", "RUNTIME_DIR": "runtime"}
    environment = os.environ | {f"JUPYTER_{name}": str(checkout / folder) for name, folder in folders.items()}
    environment |= {"IPYTHONDIR": str(checkout / "ipython"), "BROWSER": "true %s", "JUPYTER_PREFER_ENV_PATH": "1"}
    environment |= {f"JUPYTERLAB_{name}_DIR": str(checkout / name.lower()) for name in ("SETTINGS", "WORKSPACES")}
    lines = subprocess.check_output(["make", "--dry-run", "lab"], cwd=checkout, text=True).splitlines()
    command = ["env", *lines[-1].split(), "--port=0"]  # the line begins with a variable
    with (checkout / "lab.log").open("w") as log:
        streams = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
        server = subprocess.Popen(command, cwd=checkout, env=environment, **streams)
    try:
        context = browser.new_context(viewport={"width": 1400, "height": 1250})
        opened = context.new_page()
        opened.set_default_timeout(PATIENCE)
        opened.goto(_address(checkout, server))
        opened.get_by_text("Python 3 (ipykernel) | Idle").wait_for()
        run_all(opened)
        yield opened
        context.close()
    finally:
        server.terminate()
        server.wait(30)


def _address(checkout, server):
    """Of the notebook, from the page that the server hands to the web browser."""
    for _ in range(PATIENCE // 100):
        for path in (checkout / "runtime").glob("jpserver-file-to-run-*-open.html"):
            if match := re.search(r'url=(http://[^"]+)"', path.read_text()):
                return match[1]
        assert server.poll() is None, (checkout / "lab.log").read_text()
        time.sleep(0.1)
    raise AssertionError((checkout / "lab.log").read_text())


@pytest.fixture(autouse=True)
def screenshot(request, page):
    """What the page looked like after each test, for a person to look at: TRAS_SCREENSHOTS names a folder."""
    yield
    if folder := os.environ.get("TRAS_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"{request.node.name}.png")


def run_all(page):
    """As the notebook asks for."""
    page.get_by_role("menuitem", name="Run", exact=True).click()
    page.get_by_role("menuitem", name=re.compile("^Run All Cells")).click()
    page.locator(".widget-image").first.wait_for()


def picture(page):
    return page.locator(".widget-image").first.get_attribute("src")


def opacity(page):
    """Of the picture and the numbers."""
    return page.locator(".widget-image").first.evaluate(
        "image => Number(getComputedStyle(image.parentElement).opacity)"
    )


def numbers(page):
    return page.locator(".widget-html table").inner_text()


def message(page):
    return page.get_by_role("status").filter(visible=True).first


def row(page, label):
    return page.locator(".widget-inline-hbox", has=page.get_by_text(label, exact=True))


def drag(page, label, share):
    """Take the handle of a slider with the mouse and let it go at a share of its length."""
    track = row(page, label).locator(".noUi-base")
    track.scroll_into_view_if_needed()
    handle, along = row(page, label).locator(".noUi-handle").bounding_box(), track.bounding_box()
    middle = handle["y"] + handle["height"] / 2
    page.mouse.move(handle["x"] + handle["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(along["x"] + share * along["width"], middle, steps=8)
    page.mouse.up()


def eventually(page, holds):
    """Wait until it holds: picture, numbers and message arrive one after the other."""
    for _ in range(PATIENCE // 100):
        if holds():
            return
        page.wait_for_timeout(100)
    assert holds()


def functions(page):
    match = re.match(r"N = (\d+) functions", message(page).inner_text())
    return int(match[1]) if match else None


def test_make_lab_opens_the_explorer_and_it_shows_the_papers_choice(page):
    assert "/lab/tree/notebooks/explore.ipynb" in page.url
    assert "4.0589" in numbers(page) and "5.5889" in numbers(page)
    assert functions(page) == 9
    assert page.get_by_text("notified").count() == 0  # no question about news


def test_run_all_ends_at_the_panel(page):
    def in_view(locator):
        box, height = locator.bounding_box(), page.viewport_size["height"]
        return box is not None and box["y"] >= 0 and box["y"] + box["height"] <= height

    eventually(page, lambda: in_view(page.locator(".widget-image").first) and in_view(row(page, "input")))


def test_nothing_went_wrong(page):
    assert page.locator(".jp-RenderedText[data-mime-type='application/vnd.jupyter.stderr']").count() == 0
    assert page.locator(".jp-OutputArea-output[data-mime-type='application/vnd.jupyter.error']").count() == 0


def test_a_slider_changes_figure_and_numbers(page):
    before, former = picture(page), numbers(page)
    drag(page, "size", 0.2)
    eventually(page, lambda: picture(page) != before and numbers(page) != former and (functions(page) or 0) > 20)


def test_a_menu_changes_figure_numbers_and_what_can_be_set(page):
    before, former = picture(page), numbers(page)
    row(page, "dictionary").locator("select").select_option("monomials")
    eventually(page, lambda: picture(page) != before and numbers(page) != former and functions(page) == 28)
    assert row(page, "width").locator(".noUi-target").get_attribute("disabled") is not None


def test_a_wrong_choice_is_answered_by_a_sentence(page):
    before = picture(page), numbers(page)
    drag(page, "duration (s)", -0.1)
    message(page).filter(has_text="cannot be simulated").wait_for()
    assert "raise it or the duration" in message(page).inner_text()
    assert "Traceback" not in page.locator(".jp-Notebook").inner_text()
    assert (picture(page), numbers(page)) == before
    eventually(page, lambda: opacity(page) < 0.5)
    drag(page, "duration (s)", 0.3)
    eventually(page, lambda: picture(page) != before[0] and functions(page) == 28)
    eventually(page, lambda: opacity(page) == 1)


def test_the_choice_is_kept_as_a_parameter_file(page, checkout):
    page.get_by_role("button", name="save as params/mine.yaml").click()
    page.get_by_text("make all PROFILE=mine", exact=False).first.wait_for()
    choice = yaml.safe_load((checkout / "params" / "mine.yaml").read_text())["09_pictures"]["choice"]
    assert choice["dictionary"] == "monomials" and choice["size"] == 2 and 200 < choice["duration"] < 500


def test_the_rig_moves_on_demand(page):
    page.get_by_role("button", name="the rig in motion").click()
    moving = page.locator(".widget-image").nth(1)
    moving.wait_for()
    eventually(page, lambda: moving.evaluate("image => image.naturalWidth") == 440)
