"""A made-up stream of people and forecasts, and a page of Chromium to look at it with."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from neurosym_jax.models.forecast import Model
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_robot.dashboard.dashboard import Dashboard
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.online.predictor import ModelForecast
from neurosym_robot.online.replay import Analytics, ReplayEvent
from neurosym_robot.online.status import Status
from neurosym_robot.online.window import Window
from neurosym_robot.tracking.following import Frame
from tests.robot.forecasts import made_forecast

MODELS = {
    "SGAN": Model(GeneratorConfig(), {}),
    "NeuroSyM": Model(GeneratorConfig(pooling="as_described"), {}),
}
Shown = tuple[ReplayEvent, dict]


def predictor() -> Any:
    """What a page needs of a predictor."""
    return SimpleNamespace(
        models=MODELS,
        window=Window(8, 0.4, memory=5.0),
        programs=SimpleNamespace(add=lambda use: None),
        seconds_ahead=3.2,
        dropped={},
        health={},
        scales={},
        is_light=False,
        place=None,
    )


def shown(seconds: float, people: int = 3, start: float = 1.7e9) -> Iterator[Shown]:
    """People on straight ways at 10 Hz; forecasts that err by so much, with every frame."""
    fake = predictor()
    analytics = Analytics(fake)
    status = Status(fake, analytics)
    rng = np.random.default_rng(0)
    origin, speed = rng.uniform(-3, 3, (2, people, 1, 2))
    for n in range(int(10 * seconds)):
        ids = np.arange(people) + 2**53  # Beyond what JavaScript counts.
        frame = Frame(start + n / 10, ids, (origin + speed * n / 10)[:, 0])
        fake.window.push(*frame)
        status.heard(frame.stamp, 0.01)
        forecast = None
        fake.dropped = {
            7: "short",
            9: "<script>",
            **dict.fromkeys(ids.tolist(), "short"),
        }
        if n >= 28:
            now = np.arange(-7, 9)[:, None] * 0.4 + n / 10
            path = origin + speed * now
            spread = rng.normal(0, 0.1, (5, people, 8, 2)).cumsum(axis=2)
            models = {}
            for name, width in (("SGAN", 2.0), ("NeuroSyM", 1.0)):
                samples = path[:, 8:] + width * spread
                models[name] = ModelForecast(samples, samples.mean(axis=0), 2)
            fake.dropped = {7: "short", 9: "<script>"}
            forecast = made_forecast(
                path[:, :8],
                models,
                stamp=frame.stamp,
                index=n,
                ids=ids,
                dropped=fake.dropped,
            )
            status.published(1e-3 * (n % 5 + 1))
        analytics.add(forecast)
        yield ReplayEvent(frame, forecast), status.now()


@pytest.fixture
def moments() -> Moments:
    return Moments(predictor(), title="three people </script>")


@pytest.fixture
def dashboard(moments) -> Iterator[Dashboard]:
    dashboard = Dashboard(moments, port=0)
    yield dashboard
    dashboard.close()


@pytest.fixture
def stream() -> Callable[..., Iterator[Shown]]:
    return shown


@pytest.fixture
def page(browser):
    """A page that fails the test where its script does, or where its policy forbids something."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    page = context.new_page()
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "console",
        lambda line: wrong.append(line.text) if line.type == "error" else None,
    )
    page.set_default_timeout(10_000)
    yield page
    context.close()
    assert not wrong
