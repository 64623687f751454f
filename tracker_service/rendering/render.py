"""Video of a character's log: MuJoCo off-screen by EGL, else OSMesa, else drawn without a graphics library."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from shared.errors import InvalidInputError, MotionLoopError
from tracker_service.rendering.video_job import VideoJob, save_job

Backend = Literal["egl", "osmesa", "drawn"]
INSTALL_NOTE = (
    "no OpenGL for MuJoCo was found, so the skeleton was drawn without it; "
    "for the rendered figure install libegl1 (or libosmesa6): sudo apt-get install libegl1 libgl1-mesa-dri"
)


class RenderingError(MotionLoopError):
    """The rendering process failed or took too long."""

    code = "rendering"
    retryable = True


@dataclass(frozen=True)
class RenderedVideo:
    """An MP4, what drew it, and a note for the user where it is not the best there is."""

    mp4: bytes
    renderer: Backend
    note: str | None


class VideoRenderer:
    """Renders jobs in child processes of low priority, a few at a time.

    Args:
        backends: in order of preference; the first that works is kept. `drawn` always works.
        concurrent: videos made at the same time; further ones wait.
        timeout_s: for one video.
    """

    def __init__(
        self,
        backends: tuple[Backend, ...] = ("egl", "osmesa", "drawn"),
        concurrent: int = 1,
        timeout_s: float = 3600.0,
    ):
        self._backends = backends
        self._slots = threading.BoundedSemaphore(concurrent)
        self._timeout_s = timeout_s
        self._probe_lock = threading.Lock()
        self._chosen: Backend | None = None
        self._children: set[subprocess.Popen[bytes]] = set()
        self._closed = False

    def backend(self) -> Backend:
        """The backend in use, found by rendering a tiny frame in a child process the first time."""
        with self._probe_lock:
            if self._chosen is None:
                self._chosen = self._first_that_works()
            return self._chosen

    def render(self, job: VideoJob) -> RenderedVideo:
        """Make the video; blocks until it is there.

        Raises:
            InvalidInputError: nothing to render.
            RenderingError: the rendering process failed even without a graphics library.
        """
        if len(job.body_pos_w_m) == 0:
            raise InvalidInputError("no ticks to render", field="stop_tick", allowed="> start_tick, <= now")
        job = replace(job, width=job.width // 2 * 2, height=job.height // 2 * 2)
        with self._slots, tempfile.TemporaryDirectory(prefix="motionloop-video-") as name:
            folder = Path(name)
            save_job(job, folder)
            backend = self.backend()
            error = self._run(folder, backend)
            if error is not None and backend != "drawn":
                backend, failed = "drawn", backend
                error = self._run(folder, backend)
                note: str | None = f"rendering by {failed} failed, so the skeleton was drawn without OpenGL"
            else:
                note = INSTALL_NOTE if backend == "drawn" else None
            if error is not None:
                raise RenderingError(f"rendering failed: {error}")
            return RenderedVideo((folder / "video.mp4").read_bytes(), backend, note)

    def close(self) -> None:
        """End running renderings; their `render` raises RenderingError."""
        self._closed = True
        for child in tuple(self._children):
            child.terminate()

    def _first_that_works(self) -> Backend:
        for backend in self._backends:
            if backend == "drawn" or self._works(backend):
                return backend
        return "drawn"

    def _works(self, backend: Backend) -> bool:
        with tempfile.TemporaryDirectory(prefix="motionloop-probe-") as name:
            return self._run(Path(name), backend, "--probe", timeout_s=60.0) is None

    def _run(self, folder: Path, backend: Backend, *options: str, timeout_s: float | None = None) -> str | None:
        """Run the worker; None when it succeeded, else the end of what it said."""
        if self._closed:
            return "the renderer is closed"
        command = [sys.executable, "-m", "tracker_service.rendering.render_worker", str(folder), backend, *options]
        root = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        # Mesa's software renderer takes every core it finds, which the physics needs: LP_NUM_THREADS bounds it.
        environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
        log = folder / f"{backend}.log"
        with log.open("wb") as out:
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, env=environment
            )
            self._children.add(child)
            try:
                os.setpriority(os.PRIO_PROCESS, child.pid, 10)
                code = child.wait(timeout_s or self._timeout_s)
            except ProcessLookupError:
                code = child.wait()
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
                return f"it took longer than {timeout_s or self._timeout_s:.0f} s"
            finally:
                self._children.discard(child)
        if code == 0:
            return None
        lines = log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit code {code}"
