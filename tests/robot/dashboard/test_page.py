"""The page in a real browser: live and from a file, by keyboard, on a phone, with a crowd."""

import re
import threading
import time

import numpy as np
import pytest

from neurosym_robot.dashboard.dashboard import ReplayFile
from neurosym_robot.online.pairs import likely_events

ADE = "#errors tbody tr:has-text('{}') td[data-key=published_ade]"


@pytest.fixture
def play(page, moments, tmp_path):
    """`play(events)` opens a new file of them, which it returns; `stop` goes to its end."""

    def make(events, stop=True) -> str:
        path = tmp_path / f"replay{len(list(tmp_path.iterdir()))}.html"
        file = ReplayFile(path, moments)
        for event in events:
            file.show(*event)
        file.close()
        page.goto(path.as_uri())
        if stop:
            press(page, "End")
        return path.as_uri()

    return make


@pytest.fixture
def live(dashboard, stream):
    """A dashboard that is shown 12 s at once, then three minutes as fast as they would be."""
    closing = threading.Event()

    def show() -> None:
        for n, event in enumerate(stream(180)):
            if n > 120 and closing.wait(0.05):
                return
            dashboard.show(*event)

    thread = threading.Thread(target=show)
    thread.start()
    yield dashboard
    closing.set()
    thread.join()


def places(page) -> str:
    """What a screen reader is told of the scene."""
    return page.locator("#scene").get_attribute("aria-label")


def seconds(page) -> float:
    minutes, rest = page.locator("#clock").inner_text().split(" / ")[0].split(":")
    return 60 * int(minutes) + float(rest)


def press(page, key: str) -> None:
    """Press a key, and wait for the next frame of the screen but one."""
    page.keyboard.press(key)
    page.evaluate(
        "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )


def test_live(page, live, stream):
    page.goto(live.where)
    page.wait_for_function(
        "() => scene.ariaLabel.startsWith('3 people seen, 3 forecast')"
    )
    assert page.locator("#status").inner_text() == "live"
    before, clock = places(page), seconds(page)
    assert re.match(r"3 people seen, 3 forecast. 9007199254740992 at ", before)
    page.wait_for_function("before => scene.ariaLabel !== before", arg=before)
    assert seconds(page) > clock
    # Errors come with the truth, 3.2 s after the first forecast.
    page.evaluate("analysis.open = true")
    page.locator(ADE.format("SGAN")).wait_for()
    # Paused, time stands still, though what is live goes on.
    press(page, "Space")
    page.get_by_text("paused, live goes on").wait_for()
    before, clock = places(page), seconds(page)
    limit = int(page.locator("#timeline").get_attribute("max"))
    page.wait_for_function("limit => timeline.max > limit + 5", arg=limit)
    assert (seconds(page), places(page)) == (clock, before)
    # Age and errors are those of that moment.
    events = list(stream(clock + 0.2))
    now = events[round(10 * clock)][1]
    assert f"{now['age']:.1f} ms" in page.locator("#tiles").inner_text()
    scores = [event[1]["score"] for event in events[: round(10 * clock) + 1 : 4]][-1][
        "models"
    ]
    for name in ("SGAN", "NeuroSyM"):
        assert (
            page.locator(ADE.format(name)).inner_text()
            == f"{scores[name]['published_ade']:.2f}"
        )
    # Back in time, forth, and to what is live again.
    press(page, "Shift+ArrowLeft")
    assert seconds(page) == pytest.approx(clock - 4, abs=0.4)
    press(page, "ArrowRight")
    assert seconds(page) == pytest.approx(clock - 3.6, abs=0.4)
    page.get_by_role("button", name="Live").click()
    page.wait_for_function(
        "() => document.getElementById('status').innerText === 'live'"
    )
    page.wait_for_function("() => clock.innerText.length > 0")


STATES = """
new MutationObserver(() => {
  const state = document.getElementById("status")?.innerText;
  if (state) (window.states ??= new Set()).add(state);
}).observe(document, { subtree: true, childList: true, characterData: true });
"""


def test_a_dead_stream_is_never_called_live(page, dashboard, stream):
    """The publisher died 65 s before the page is opened: what was kept is history."""
    for event in stream(4):
        dashboard.show(*event)
    now, fresh = dashboard._server.fresh
    dashboard._server.fresh = now, fresh - 65.0
    page.add_init_script(STATES)
    page.goto(dashboard.where)
    page.get_by_text(re.compile(r"^stale for 6\d s")).wait_for()
    page.get_by_text(
        re.compile(r"The newest people are 6\d s old: this is not now")
    ).wait_for()
    tiles = page.locator("#tiles").inner_text()
    assert int(re.search(r"age\n(\d+) ms", tiles)[1]) >= 65_000
    assert "input\n0.0 Hz" in tiles
    assert page.locator("#missing").inner_text() == "All 3 people have a forecast."
    page.wait_for_timeout(1500)
    states = page.evaluate("[...states]")
    assert states
    assert not any(state.startswith("live") for state in states)


def test_a_slow_stream_is_live_and_its_age_and_rate_are_those_of_now(
    page, dashboard, stream
):
    *events, (event, now) = stream(4)
    for row in events:
        dashboard.show(*row)
    page.goto(dashboard.where)
    page.get_by_text("live", exact=True).first.wait_for()
    page.get_by_text(re.compile(r"^stale for \d+ s")).wait_for()  # Nothing more comes.
    dashboard.show(event, {**now, "lag": 1.2, "rate": 0.5})
    page.wait_for_function(
        "() => document.getElementById('status').innerText === 'live'"
    )
    assert "input\n0.5 Hz" in page.locator("#tiles").inner_text()
    later = event._replace(frame=event.frame._replace(stamp=event.frame.stamp + 0.1))
    dashboard.show(later, {**now, "lag": 30.0})  # New, but of half a minute ago.
    page.get_by_text("stale for 30 s").wait_for()


def test_a_file_to_share(page, play, stream):
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    uri = play(stream(20), stop=False)
    assert page.title() == "three people </script>"
    page.get_by_text("playing").wait_for()
    page.wait_for_function("() => timeline.value > 3")
    press(page, "Space")
    clock = seconds(page)
    time.sleep(0.3)
    assert seconds(page) == clock
    press(page, "ArrowRight")
    clock = seconds(page)
    press(page, "ArrowRight")
    assert seconds(page) == pytest.approx(clock + 0.4)
    press(page, "End")
    assert seconds(page) == pytest.approx(19.9)
    assert requests == [uri]  # It needs nothing else.


def test_who_has_no_forecast_and_why(page, play, stream):
    play(stream(2.05))
    missing = page.locator("#missing").inner_text()
    assert missing.startswith("seen for 1.9 s: once, or for less than --min-seen")
    assert all(str(2**53 + n) in missing for n in range(3))
    *events, (event, now) = stream(6)
    lost = event.frame._replace(ids=event.frame.ids[1:], xy=event.frame.xy[1:])
    later = [(event._replace(frame=lost), {**now, "missing": {2**53 + 2: "compiling"}})]
    play(events + later)
    missing = page.locator("#missing").inner_text()
    assert "program for so many people is being compiled: 9007199254740994" in missing
    play(stream(6))
    assert page.locator("#missing").inner_text() == "All 3 people have a forecast."


def test_who_comes_near_the_robot(page, play, stream):
    events = list(stream(6.1))
    forecast = events[-1][0].forecast
    # The robot follows the first person's most probable path a metre beside it, at its
    # speed.
    path = forecast.observed[0]
    speed = (path[-1] - path[-2]) / 0.4
    aside = np.array([-speed[1], speed[0]]) / np.hypot(*speed)
    robots = [path[-1] + aside + speed * (n - 60) / 10 for n in range(61)]
    events = [
        (event._replace(robot=np.array([*at, 0.0])), now)
        for (event, now), at in zip(events, robots)
    ]
    play(events)
    near = page.locator("#near tbody tr", has_text=str(2**53)).inner_text().split("\t")
    samples = forecast.models["SGAN"].samples
    robot = path[-1] + aside + speed * 0.4 * np.arange(1, 9)[:, None]
    least = np.linalg.norm(samples[:, 0] - robot, axis=-1).min(axis=1)
    assert near[1] == "1.0 m"
    assert float(near[2].split()[0]) <= min(1.0, least[2]) + 0.06
    edge = "e => near.getBoundingClientRect().right <= e.getBoundingClientRect().right"
    assert page.locator("aside").evaluate(edge)  # With ids of 16 digits.
    play(stream(4), stop=False)
    page.get_by_text("The robot's place is not known").wait_for()


def test_the_pair_and_what_is_likely(page, moments, play, stream):
    events = list(stream(6.05))
    play(events)
    page.evaluate("analysis.open = true")
    person, other = str(2**53), str(2**53 + 2)
    page.locator("#k").select_option(person)
    page.locator("#l").select_option(other)

    def symbols():
        page.wait_for_timeout(100)
        return page.locator("#symbols dd").all_inner_texts()

    forecast = next(e[0].forecast for e in reversed(events[:57]))
    code = int(moments.pairs.newest(forecast.observed)[0][0, 2])
    expected = ["−0+"[code // place % 3] for place in (27, 9, 3, 1)]
    assert symbols() == expected
    assert (
        "counts 0.067 for k" in page.locator("#alpha").inner_text()
    )  # One of 15 neighbours.
    page.locator("#l").select_option(person)
    page.locator("#k").select_option(other)
    assert symbols() == [expected[n] for n in (1, 0, 3, 2)]  # the converse
    probable = likely_events(forecast, "NeuroSyM", 0.4)
    line = page.locator("#likely li").first.inner_text()
    assert any(
        re.sub(r"\W+", "", e.words(forecast.ids)) == re.sub(r"\W+", "", line)
        for e in probable
    )


def test_by_keyboard_and_on_a_phone(page, play, stream):
    play(stream(8))
    screenshot = page.locator("#scene").screenshot()
    page.get_by_role("checkbox", name="SGAN").uncheck()
    assert page.locator("#scene").screenshot() != screenshot
    for theme in ("Light", "Dark"):
        press(page, "t")
        assert page.get_by_role("button", name=theme).is_visible()
    # Everything that can be used is reached by the tab key, and has a name.
    page.locator("#fit").focus()
    reached = set()
    for _ in range(20):
        reached.add(
            page.evaluate("document.activeElement.id || document.activeElement.type")
        )
        press(page, "Tab")
    assert {"theme", "checkbox", "play", "timeline"} <= reached
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate("scene.clientHeight") > 300


def test_who_loses_the_connection_gets_what_was_missed(page, dashboard, stream):
    events = list(stream(12))
    for event in events[:60]:
        dashboard.show(*event)
    page.goto(dashboard.where)
    page.wait_for_function("() => timeline.max == 59")
    page.context.set_offline(True)
    page.context.set_offline(False)
    for event in events[60:]:
        dashboard.show(*event)
    dashboard.end(events[-1][1]["score"])
    page.get_by_text("recording ended").wait_for()
    assert page.locator("#timeline").get_attribute("max") == "119"
