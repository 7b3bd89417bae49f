"""The page of the viewer: a stage in 3-D, its reasons beside it, a slider over the stages; of this machine only."""

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

from halfseen.view.stage_view import Poses, Watched, stage_html
from halfseen.view.viewer import HERE, LAYERS, Scene, local_server, look_from_aside, stop

_MOMENT_S, _STAGE_S = 0.12, 2.0
_EMPTY = '<div class="halfseen-stage" style="padding:0 0.75em"><p>looking …</p></div>'


class Page:
    """A page at `url` until it is closed: a stage in 3-D, its reasons beside it, a slider over the stages.

    Raises
    ------
    ArgumentError
        The viewer is not installed, or the port (0 for any that is free) is taken.
    """

    def __init__(self, port: int) -> None:
        self._server = local_server(port)
        self.url = f"http://{HERE}:{self._server.get_port()}"
        self._lock = threading.RLock()
        self._watched: Watched | None = None
        self._index, self._is_playing = 0, False
        self._stop = threading.Event()
        self._scene = Scene(self._server.scene)
        self._add_controls()

    def close(self) -> None:
        """Serve no longer."""
        self._stop.set()
        stop(self._server)

    def wait(self) -> None:
        """Serve until somebody interrupts."""
        with contextlib.suppress(KeyboardInterrupt):
            while not self._stop.wait(3600):
                pass

    def show(self, watched: Watched) -> None:
        """Show a run; one that grew stays where it was, or goes on to its newest stage if it was at the last."""
        with self._lock:
            num_before = 0 if self._watched is None else len(self._watched.stages)
            was_last = self._index + 1 >= num_before
            self._watched = watched
            num_stages = len(watched.stages)
            self._slider.max = max(num_stages, 2)
            self._slider.visible = self._buttons.visible = num_stages > 1
            self._play.visible = num_stages > 1 or len(watched.stages[0].poses) > 1
            if num_before == 0:
                look_from_aside(self._server, watched)
            self.go_to(num_stages - 1 if num_before and was_last else min(self._index, num_stages - 1))

    def go_to(self, index: int) -> None:
        """Show the stage with this number, from 0; the nearest if there is none."""
        with self._lock:
            if self._watched is None:
                return
            self._index = max(0, min(index, len(self._watched.stages) - 1))
            if self._slider.value != self._index + 1:
                self._slider.value = self._index + 1
            stage = self._watched.stages[self._index]
            with self._server.atomic():
                self._scene.show(stage, self._watched.parts)
                self._words.content = stage_html(stage)

    def _add_controls(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._slider: Any = gui.add_slider("stage", min=1, max=2, step=1, initial_value=1, visible=False)
        self._buttons: Any = gui.add_button_group("step", ("back", "on"), visible=False)
        self._play: Any = gui.add_button("play", visible=False)
        self._words: Any = gui.add_html(_EMPTY)
        with gui.add_folder("layers", expand_by_default=False):
            for layer, words in LAYERS.items():
                box: Any = gui.add_checkbox(words, True)
                box.on_update(lambda _, layer=layer, box=box: self._scene.set_visible(layer, box.value))

        @self._slider.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                self.go_to(int(self._slider.value) - 1)

        @self._buttons.on_click
        def _(_: Any) -> None:
            self.go_to(self._index + (1 if self._buttons.value.startswith("on") else -1))

        @self._play.on_click
        def _(_: Any) -> None:
            self._set_playing(not self._is_playing)

    def _set_playing(self, is_playing: bool) -> None:
        with self._lock:
            self._is_playing = is_playing
            self._play.label = "pause" if is_playing else "play"
        if is_playing:
            threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        """Play from the stage that is shown; from the first if that is the last."""
        assert self._watched is not None, "what is played is there"
        if self._index + 1 == len(self._watched.stages) > 1:
            self.go_to(0)
        while self._is_playing:
            index = self._index
            if not self._moved(self._watched.stages[index].poses, index) or not self._is_playing:
                return
            if index != self._index:
                continue
            if index + 1 >= len(self._watched.stages):
                self._set_playing(False)
                return
            self.go_to(index + 1)

    def _moved(self, poses: Poses, index: int) -> bool:
        """Move the arm through a stage, or wait; False if the page was closed or paused meanwhile.

        It ends early where somebody goes to another stage.
        """
        if len(poses) < 2:
            return not self._stop.wait(_STAGE_S) and self._is_playing
        for moment in range(len(poses)):
            with self._lock:
                if self._index == index and self._is_playing:
                    with self._server.atomic():
                        self._scene.place(poses, moment)
            if self._index != index:
                return True
            if not self._is_playing or self._stop.wait(_MOMENT_S):
                return False
        return True


@contextlib.contextmanager
def served(port: int) -> Iterator[Page]:
    """Serve a page while something runs."""
    page = Page(port)
    try:
        yield page
    finally:
        page.close()
