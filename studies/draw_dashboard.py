"""The live view's picture in docs/robot.md: `python -m studies.draw_dashboard`.

Four simulated people in their room, forecast by the models that ship; needs playwright
and Chromium.
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from neurosym_jax import load_model
from neurosym_jax.simulation.scenarios import ROOM, simulate
from neurosym_robot.dashboard import ReplayFile
from neurosym_robot.dashboard.floor_map import read_floor_map
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frames import frames_of_tracks
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.replay import replay

ROOT = Path(__file__).parents[1]
CELL, WALL = 0.05, 3  # metres; cells


def draw_room(folder: Path) -> Path:
    """The walls, as ROS's map_server saves them."""
    width, height = (round(side / CELL) + 2 * WALL for side in ROOM)
    pixels = np.zeros((height, width), np.uint8)
    pixels[WALL:-WALL, WALL:-WALL] = 254
    Image.fromarray(pixels).save(folder / "room.pgm")
    path = folder / "room.yaml"
    origin = -WALL * CELL
    path.write_text(f"image: room.pgm\nresolution: {CELL}\norigin: [{origin}, {origin}, 0]\n")
    return path


def main() -> None:
    """Replay, open the page, take its picture."""
    shipped = ROOT / "checkpoints"
    models = {
        "SGAN": load_model(shipped / "sgan_simulations_8_8"),
        "NeuroSyM": load_model(shipped / "neurosym_simulations_8_8"),
    }
    predictor, analytics = Predictor(models, max_people=4), Analytics()
    tracks = simulate("cross-path", seed=4, duration=40.0, people=4)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        moments = Moments(
            models, title="Four people cross", floor_map=read_floor_map(draw_room(folder))
        )
        file = ReplayFile(folder / "replay.html", moments)
        for event in replay(frames_of_tracks(tracks), predictor, analytics):
            file.show(event.frame, event.forecast, analytics.summary())
        file.close()
        with sync_playwright() as play:
            chromium = play.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
            )
            page = chromium.new_page(viewport={"width": 1280, "height": 720}, color_scheme="light")
            page.goto((folder / "replay.html").as_uri())
            page.keyboard.press("Home")
            for _ in range(4):
                page.keyboard.press("Shift+ArrowRight")
            page.wait_for_timeout(500)
            page.screenshot(path=folder / "page.png")
            chromium.close()
        # 224 colours are enough for it, and a third of the bytes.
        image = (
            Image.open(folder / "page.png").convert("RGB").quantize(224, dither=Image.Dither.NONE)
        )
        image.save(ROOT / "docs/figures/dashboard.png", optimize=True)


if __name__ == "__main__":
    main()
