"""The page in a real browser: people move, it pauses, it says the error; live and from a file."""

import dataclasses
import re
import threading
import time

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.symbolic import symbolic_forecast
from neurosym_robot.dashboard import Dashboard, ReplayFile
from neurosym_robot.online.analytics import STRAIGHT
from neurosym_robot.online.pairs import LikelyEvents
from neurosym_robot.online.predictor import ModelForecast

ADE = "#errors tbody tr:has-text('{}') td[data-key=joint_ade]"


def write_replay(events, path, moments):
    file = ReplayFile(path, moments)
    for event in events:
        file.show(*event)
    file.close()


@pytest.fixture
def live(moments, stream):
    """A dashboard that is shown 12 s at once, then three minutes as fast as they would be."""
    dashboard = Dashboard(moments, port=0)
    dashboard.start()
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
    dashboard.close()


def places(page) -> str:
    """What a screen reader is told of the scene."""
    return page.locator("#scene").get_attribute("aria-label")


def seconds(page) -> float:
    minutes, rest = page.locator("#clock").inner_text().split(" / ")[0].split(":")
    return 60 * int(minutes) + float(rest)


def drawn(page) -> None:
    """Wait until the page shows what it was told: it draws with the next frame of the screen."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def press(page, key: str) -> None:
    page.keyboard.press(key)
    drawn(page)


def test_live(page, live, stream):
    page.goto(live.url)
    page.locator(ADE.format("SGAN"), has_text=re.compile(r"\d\.\d\d")).wait_for()
    assert page.locator("#status").inner_text() == "live"
    # The table of errors is there before the scene is: that is drawn with the screen's next frame.
    page.wait_for_function("scene.ariaLabel.startsWith('3 people seen, 3 forecast')")
    before, clock = places(page), seconds(page)
    assert re.match(r"3 people seen, 3 forecast. 9007199254740992 at ", before)
    page.wait_for_function("before => scene.ariaLabel !== before", arg=before)
    assert seconds(page) > clock
    # Paused, time stands still, though what is live goes on.
    press(page, "Space")
    page.get_by_text("paused, live goes on").wait_for()
    page.wait_for_timeout(50)
    before, clock = places(page), seconds(page)
    limit = int(page.locator("#timeline").get_attribute("max"))
    page.wait_for_function("limit => timeline.max > limit + 5", arg=limit)
    assert seconds(page) == clock
    assert places(page) == before
    # The errors are those of that moment.
    frames = list(stream(clock + 0.2))
    score = frames[round(10 * clock)][2]["models"]
    for name in ("SGAN", "NeuroSyM"):
        assert page.locator(ADE.format(name)).inner_text() == f"{score[name]['joint_ade']:.2f}"
    # Back in time, forth, and to what is live again.
    press(page, "Shift+ArrowLeft")
    assert seconds(page) == pytest.approx(clock - 4, abs=0.4)
    press(page, "ArrowRight")
    assert seconds(page) == pytest.approx(clock - 3.6, abs=0.4)
    page.get_by_role("button", name="Live").click()
    drawn(page)
    assert page.locator("#status").inner_text() == "live"
    assert seconds(page) > clock


def test_the_robot_is_drawn_and_constant_velocity_told(page, moments, stream, tmp_path):
    events = list(stream(8))
    pictures = []
    for robot in (None, np.array([0.5, -1.0, 0.8])):
        path = tmp_path / f"{robot is None}.html"
        write_replay(((*event, robot) for event in events), path, moments)
        page.goto(path.as_uri())
        press(page, "End")
        drawn(page)
        pictures.append(page.locator("#scene").screenshot())
    assert pictures[0] != pictures[1]
    score = events[-1][2]["models"][STRAIGHT]
    assert page.locator(ADE.format(STRAIGHT)).inner_text() == f"{score['joint_ade']:.2f}"


def test_what_is_old_is_not_called_live(page, moments, stream):
    dashboard = Dashboard(moments, port=0)
    dashboard.start()
    events = list(stream(4))
    for event in events[:-1]:
        dashboard.show(*event)
    page.goto(dashboard.url)
    page.get_by_text(re.compile(r"stale: nothing heard for \d+ s")).wait_for()
    page.get_by_text(re.compile(r"No people for \d+ s: this is not now")).wait_for()
    dashboard.show(*events[-1])
    page.wait_for_function("status => document.getElementById('status').innerText === 'live'")
    dashboard.close()


def test_who_is_extrapolated_is_named(page, moments, stream, tmp_path):
    *events, (frame, forecast, summary) = stream(6.1)
    lost = dataclasses.replace(forecast, extrapolated=np.array([0, 2, 0]))
    write_replay([*events, (frame, lost, summary)], tmp_path / "replay.html", moments)
    page.goto((tmp_path / "replay.html").as_uri())
    press(page, "End")
    assert "forecast though lost" in page.locator("#dropped").inner_text()
    assert str(2**53 + 1)[-4:] in page.locator("#dropped li").last.inner_text()


def test_a_file_to_share(page, moments, stream, tmp_path):
    path = tmp_path / "replay.html"
    events = list(stream(20))
    write_replay(events, path, moments)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    assert page.title() == "three people </script>"
    page.get_by_text("playing").wait_for()
    page.wait_for_function("() => timeline.value > 3")
    page.get_by_role("button", name="Pause").click()
    drawn(page)
    clock, before = seconds(page), places(page)
    time.sleep(0.3)
    assert seconds(page) == clock
    press(page, "ArrowRight")
    clock = seconds(page)
    press(page, "ArrowRight")
    assert seconds(page) == pytest.approx(clock + 0.4)
    press(page, "End")
    assert seconds(page) == pytest.approx(19.9)
    assert places(page) != before
    score = events[-1][2]
    assert page.locator(ADE.format("NeuroSyM")).inner_text() == (
        f"{score['models']['NeuroSyM']['joint_ade']:.2f}"
    )
    assert page.locator("#dropped").inner_text().count("\n") == 1
    assert "<script>" in page.locator("#dropped").inner_text()
    assert asked == [path.as_uri()]  # It needs nothing else.


def test_the_pair_and_its_symbols(page, moments, stream, tmp_path):
    write_replay(stream(8), tmp_path / "replay.html", moments)
    page.goto((tmp_path / "replay.html").as_uri())
    press(page, "End")
    symbols = [tile.split("\n")[1] for tile in page.locator("#symbols div").all_inner_texts()]
    assert page.locator("#chain .now").all_inner_texts() == symbols
    assert set("".join(symbols)) <= set("−0+")
    alpha = page.locator("#alpha output").inner_text()
    assert alpha == "0.067"  # No symbol of theirs is 0: one of 15 neighbours.
    # The other way round the converse is shown.
    k, l = page.locator("#k"), page.locator("#l")  # noqa: E741
    one, other = k.input_value(), l.input_value()
    k.select_option(other)
    l.select_option(one)
    drawn(page)
    swapped = [tile.split("\n")[1] for tile in page.locator("#symbols div").all_inner_texts()]
    assert swapped == [symbols[n] for n in (1, 0, 3, 2)]


def test_what_the_pair_and_others_will_do(page, moments, stream, tmp_path):
    events = list(stream(8))
    # The page has whole centimetres: so has the truth here, that symbols are the very same.
    for n, (frame, forecast, summary) in enumerate(events):
        if forecast is not None:
            last = np.round(forecast.observed[:, -1:], 3)
            told = {
                name: ModelForecast(last + np.round(each.samples - last, 2), each.mean, 0)
                for name, each in forecast.models.items()
            }
            events[n] = frame, dataclasses.replace(forecast, models=told), summary
    write_replay(events, tmp_path / "replay.html", moments)
    page.goto((tmp_path / "replay.html").as_uri())
    press(page, "End")
    forecast = [each for _, each, _ in events if each is not None][-1]
    pair = [forecast.ids.tolist().index(int(page.locator(f"#{who}").input_value())) for who in "kl"]
    samples = forecast.models["NeuroSyM"].samples
    wanted = np.asarray(
        symbolic_forecast(samples, forecast.observed, pairs=np.array([pair])).symbols
    )[0]
    cells = page.locator("#chain .ahead")
    shares = cells.evaluate_all(
        "all => all.map(({ style }) => ['--minus', '--plus']"
        ".map((name) => parseFloat(style.getPropertyValue(name)) / 100))"
    )
    assert_allclose(np.reshape(shares, (4, 8, 2)), wanted[:, :, [0, 2]].swapaxes(0, 1), atol=6e-4)
    likely = LikelyEvents(0.4)(forecast, "NeuroSyM")
    first = max(likely, key=lambda each: each.probability)
    line = page.locator("#likely li").first.inner_text()
    what, when = re.split(r"\s+\d+ %\s+in ", line.removesuffix(" s"))
    assert float(when) == pytest.approx(first.seconds)
    assert first.words(np.array([str(id)[-4:] for id in forecast.ids])).startswith(
        what.replace("…", "")
    )


def test_by_keyboard(page, moments, stream, tmp_path):
    write_replay(stream(8), tmp_path / "replay.html", moments)
    page.goto((tmp_path / "replay.html").as_uri())
    press(page, "?")
    assert page.get_by_role("dialog").is_visible()
    press(page, "Escape")
    assert not page.get_by_role("dialog").is_visible()
    press(page, "End")
    whole = page.locator("#scene").screenshot()
    press(page, "3")
    assert not page.get_by_role("checkbox", name="SGAN").is_checked()
    assert page.locator("#scene").screenshot() != whole
    press(page, "3")
    assert page.locator("#scene").screenshot() == whole
    press(page, "a")
    assert page.locator("#age").input_value() == "0.8"
    pair = page.locator("#k").input_value(), page.locator("#l").input_value()
    press(page, "p")
    assert pair != (page.locator("#k").input_value(), page.locator("#l").input_value())
    for theme in ("Light", "Dark"):
        press(page, "t")
        assert page.get_by_role("button", name=theme).is_visible()
    # Everything that can be used is reached by the tab key, and has a name.
    page.locator("#fit").focus()
    reached = set()
    for _ in range(30):
        reached.add(page.evaluate("document.activeElement.id || document.activeElement.type"))
        press(page, "Tab")
    assert {"theme", "help", "checkbox", "k", "l", "play", "timeline", "speed", "age"} <= reached


def test_who_loses_the_connection_gets_what_was_missed(page, moments, stream):
    events = list(stream(12))
    dashboard = Dashboard(moments, port=0)
    dashboard.start()
    for event in events[:60]:
        dashboard.show(*event)
    page.goto(dashboard.url)
    page.wait_for_function("() => timeline.max == 59")
    page.context.set_offline(True)
    page.context.set_offline(False)
    for event in events[60:]:
        dashboard.show(*event)
    dashboard.end(events[-1][2])
    page.get_by_text("recording ended").wait_for()
    assert page.locator("#timeline").get_attribute("max") == "119"
    dashboard.close()
