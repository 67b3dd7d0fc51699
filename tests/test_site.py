"""The site builds without a warning, and every page fits a phone and a desktop."""

import html
import re

import pytest

from tests.repository import run_python

SIZES = ({"width": 390, "height": 844}, {"width": 1280, "height": 800})
LOOK = """() => {
  const room = document.documentElement.clientWidth;
  const cut = [...document.querySelectorAll("article :is(table, pre, img)")].filter((element) => {
    const box = element.getBoundingClientRect();
    if (!box.width || element.closest(".filtered, details:not([open])")) return false;
    if (room < 600 && element.closest(".jp-OutputArea-output")) return false;  // scrolls
    const code = element.querySelector("code") ?? element;
    return box.right > room + 1 || box.left < -1 || code.scrollWidth > code.clientWidth + 1;
  });
  const broken = [...document.querySelectorAll("article :is(td, th)")].filter((cell) =>
    !/auto|normal/.test(getComputedStyle(cell).wordBreak)
    || getComputedStyle(cell).overflowWrap === "anywhere" && !cell.querySelector("code"));
  return {
    sideways: document.documentElement.scrollWidth - room,
    cut: cut.map((element) => element.textContent.trim().slice(0, 60) || element.src),
    broken: broken.map((cell) => cell.textContent.trim().slice(0, 60)),
    text: document.querySelector("article").innerText,
  };
}"""
"""What is beyond the window, cells that break within words, and the text that a reader sees."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as a warning ends it."""
    for name in ("mkdocs", "material", "mkdocs_jupyter"):
        pytest.importorskip(name, reason="the site needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    build = ("-m", "mkdocs", "build", "--strict", "-q", "-d", folder)
    run_python(*build, NO_MKDOCS_2_WARNING="1")
    return folder


@pytest.mark.slow
def test_the_site_has_the_reference(site):
    page = (site / "reference/symbolic/index.html").read_text()
    assert "neurosym_jax.symbolic.qtc.observe" in page
    assert "[..., T-1, m] int8" in page
    assert "neurosym replay" in (site / "reference/commands/index.html").read_text()
    for path in site.rglob("index.html"):
        text = html.unescape(re.sub(r"<[^>]+>", "", path.read_text()))
        assert not re.search(r"&(#\d+|amp|lt|gt|quot);", text), path


@pytest.mark.slow
def test_pages_fit(site, browser):
    """No page scrolls sideways, no table, code or picture is cut, no entity is printed."""
    page, faults = browser.new_page(), {}
    for path in sorted(site.rglob("index.html")):
        page.goto(path.as_uri())
        for size in SIZES:
            page.set_viewport_size(size)
            look = page.evaluate(LOOK)
            look["entity"] = re.findall(r"&(?:#\d+|amp|lt|gt);", look.pop("text"))
            wrong = {name: fault for name, fault in look.items() if fault}
            if wrong:
                faults[f"{path.parent.relative_to(site)} at {size['width']}"] = wrong
    page.close()
    assert not faults


LINES = """() => [...document.querySelectorAll("article pre > code")]
  .filter((code) => code.textContent.includes("cross-path: 8 + 8"))
  .map((code) => {
    const style = getComputedStyle(code);
    const room = code.clientHeight - parseFloat(style.paddingTop) - parseFloat(style.paddingBottom);
    return [code.textContent.trimEnd().split("\\n").length, room / parseFloat(style.lineHeight)];
  })"""
"""Lines of the printed table, and lines that it takes on the screen."""
OPTIONS = """() => [...document.querySelectorAll("article code .whole")]
  .filter((option) => option.offsetParent)
  .map((option) => option.getClientRects().length)"""
"""Lines over which each option goes."""


@pytest.mark.slow
def test_printed_tables_and_options_are_whole_on_a_phone(site, browser):
    """Rows of a table went over two lines each, and `--dashboard` was cut behind a hyphen."""
    page = browser.new_page(viewport=SIZES[0])
    page.goto((site / "index.html").as_uri())
    ((lines, shown),) = page.evaluate(LINES)
    assert lines == 6
    assert shown == pytest.approx(lines, abs=0.6)
    page.goto((site / "robot" / "index.html").as_uri())
    rectangles = page.evaluate(OPTIONS)
    assert len(rectangles) > 20
    assert set(rectangles) == {1}
    page.close()
