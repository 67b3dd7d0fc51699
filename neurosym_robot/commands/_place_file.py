"""The file of a place: read before a stream, and written while it is watched."""

import math
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import refuse_unwritable
from neurosym_robot.dashboard.view import View
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.online.onnx_network import OnnxModel
from neurosym_robot.online.replay import ReplayEvent

if TYPE_CHECKING:
    from neurosym_jax.models.forecast import Model
    from neurosym_jax.models.place.place import Place

DROPPED = (
    "the memory of the place was dropped, because forecasts had become worse with it: "
    "was the camera moved, or is the map's frame another one?"
)
EVERY = 300.0  # seconds between two times that the file is written


def open_place(
    file: Path, model: "Model | OnnxModel", half_life: float = math.inf
) -> "Place":
    """The place of a file, or a new one where there is none, which forgets by `half_life` [s].

    Raises:
        InputError: if the file is not one of a place, is of another model, or cannot be
            written; and for a model that is not in JAX.
    """
    if isinstance(model, OnnxModel):
        raise InputError("--place learns with a model in JAX, not with an .onnx file")
    from neurosym_jax.models.place.place import Place, load_place

    refuse_unwritable(file)
    if file.exists():
        return load_place(file, model, half_life=half_life)
    return Place(model, half_life=half_life)


class PlaceFile(View):
    """Writes a place now and then, and at the end; in between the file is whole."""

    title = "what people do here is in"

    def __init__(
        self,
        file: Path,
        place: "Place",
        source: PeopleSource,
        report: Callable[[str], None],
        every: float = EVERY,
    ):
        """Of a `place` that a predictor watches in the frame of the `source`.

        `report` is called with one line when the file cannot be written.
        """
        self.where = str(file)
        self._file, self._place, self._source = file, place, source
        self._report, self._every = report, every
        self._known, self._saved = place.seconds, time.monotonic()
        self._drops = place.drops
        self._writing: threading.Thread | None = None

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Note a frame, and report if the memory was dropped."""
        if self._place.drops != self._drops:
            self._drops = self._place.drops
            self._report(f"{self.where}: {DROPPED}")
        if time.monotonic() - self._saved >= self._every:
            self._saved = time.monotonic()
            self._write()

    def close(self) -> None:
        """Write what was learned."""
        self._write()
        if self._writing is not None:
            self._writing.join()

    def _write(self) -> None:
        """Begin to write in a thread: a stream does not wait for it."""
        if self._writing is not None:
            self._writing.join()
        if self._place.seconds == self._known:  # Nothing was watched.
            return
        self._known = self._place.seconds
        self._name_frame()
        arguments = (self._place.contents(),)
        self._writing = threading.Thread(target=self._write_now, args=arguments)
        self._writing.start()

    def _name_frame(self) -> None:
        frame = self._source.frame_id or ""
        if not self._place.frame and frame:
            self._place.frame = frame
            self._report(f"{self.where}: the place is in the frame {frame!r}")

    def _write_now(self, contents: Mapping[str, Any]) -> None:
        from neurosym_jax.models.place.place import write_place

        try:
            write_place(self._file, contents)
        except InputError as error:
            self._report(str(error))
