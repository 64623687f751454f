"""The tracker service: characters behind a ROUTER socket, their state frames on a PUB socket (DESIGN 5)."""

from __future__ import annotations

import logging
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from shared.errors import ConflictError, InvalidInputError, NotFoundError, OverloadedError
from shared.plugins.interfaces import Tracker
from shared.protocol.base import Message
from shared.protocol.control import Envelope, Health, HealthReport, Hello, Ok, Welcome
from shared.protocol.messages import (
    CloseCharacter,
    CreateCharacter,
    GetTicks,
    Impulse,
    Look,
    Observe,
    Pacing,
    Render,
    ResetCharacter,
    Restore,
    SetObject,
    SetPacing,
    SetScene,
    SetTracker,
    Snapshot,
    StateFrame,
    Step,
    TakeSnapshot,
    TickRange,
    Track,
    TrackReply,
    Video,
)
from shared.protocol.transport import ServiceServer, StatePublisher
from shared.scenes.files import scene_from_data
from shared.scenes.schema import Scene
from shared.tracing import fields
from tracker_service.policy.learned import WEIGHTS
from tracker_service.rendering.render import VideoRenderer
from tracker_service.rendering.video_job import VideoJob
from tracker_service.service.hosted import HostedCharacter
from tracker_service.service.log_tail import check_format
from tracker_service.service.metrics import TrackerMetrics
from tracker_service.service.realtime import RealtimeClock
from tracker_service.service.settings import TrackerServiceSettings, dump_folder
from tracker_service.service.trackers import TrackerCatalogue, builtin_trackers
from tracker_service.service.videos import video_job
from tracker_service.service.worlds import Worlds
from tracker_service.simulation.recorder import Recorder

VERSION = "0.1.0"
MAX_VIDEO_BYTES = 60 * 2**20
VIDEOS_AT_ONCE = 1
log = logging.getLogger(__name__)


class TrackerService:
    """Hosts characters. `start()` binds and serves, `stop()` ends everything; also a context manager.

    Args:
        settings: see TrackerServiceSettings.
        context: of ZeroMQ, needed for inproc; an own one is made without it.
        trackers: factories by name, for tests; the built-ins by default.
        renderer: of videos.
    """

    def __init__(
        self,
        settings: TrackerServiceSettings,
        *,
        context: zmq.Context[Any] | None = None,
        trackers: dict[str, Callable[[], Tracker]] | None = None,
        renderer: VideoRenderer | None = None,
    ):
        self.settings = settings
        self._trackers = TrackerCatalogue(
            settings.trackers, settings.default_tracker, trackers or builtin_trackers(settings.weights or WEIGHTS)
        )
        self._worlds = Worlds(settings.scenes)
        self._renderer = renderer or VideoRenderer(concurrent=VIDEOS_AT_ONCE, timeout_s=settings.video_timeout_s)
        self._videos = ThreadPoolExecutor(VIDEOS_AT_ONCE, thread_name_prefix="video")
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._spool = settings.spool_dir
        self._recordings = 0
        self._characters: dict[str, HostedCharacter] = {}
        self._lock = threading.Lock()
        self._started_s = time.monotonic()
        self._stopped = False
        self._publisher: StatePublisher | None = None
        self._clock = RealtimeClock(self._publish, workers=settings.workers, catch_up_ticks=settings.catch_up_ticks)
        self._context = context
        handlers: dict[type[Message], Callable[[Envelope, Any], Message | Future[Message]]] = {
            CreateCharacter: self._create,
            CloseCharacter: self._close,
            SetScene: self._set_scene,
            SetObject: self._set_object,
            SetTracker: self._set_tracker,
            SetPacing: self._set_pacing,
            ResetCharacter: self._reset,
            Track: self._track,
            Step: self._step,
            Observe: self._observe,
            GetTicks: self._get_ticks,
            Impulse: self._impulse,
            TakeSnapshot: self._take_snapshot,
            Restore: self._restore,
            Render: self._render,
            Health: self._health,
        }
        self._server = ServiceServer(
            settings.endpoint,
            handlers,
            self._welcome,
            workers=settings.workers,
            max_pending=settings.max_pending,
            context=context,
            curve=settings.curve_keys(),
        )
        self.metrics = TrackerMetrics(lambda: len(self._characters), lambda: self._server.pending)

    def start(self) -> TrackerService:
        """Bind both sockets and serve; `endpoint` and `state_endpoint` then hold the resolved ports."""
        if self._spool is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="motionloop-tracker-")
            self._spool = Path(self._temporary.name)
        self._publisher = StatePublisher(
            self.settings.state_endpoint, context=self._context, curve=self.settings.curve_keys()
        )
        self.settings.start_metrics(self.metrics.endpoint)
        self._clock.start()
        self._server.start()
        return self

    def stop(self) -> None:
        """Stop the clocks, end the sockets, forget the characters. Safe to call twice."""
        if self._stopped:
            return
        self._stopped = True
        self._clock.stop()
        self._renderer.close()
        self._videos.shutdown(wait=True, cancel_futures=True)
        self._server.stop()
        if self._publisher is not None:
            self._publisher.close()
        self.metrics.endpoint.close()
        for character in self._characters.values():
            character.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def __enter__(self) -> TrackerService:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def endpoint(self) -> str:
        """Where requests are taken."""
        return self._server.endpoint

    @property
    def state_endpoint(self) -> str:
        """Where state frames are published."""
        return self._publisher.endpoint if self._publisher else self.settings.state_endpoint

    def character(self, character_id: str | None) -> HostedCharacter:
        """A character by id; raises InvalidInputError without an id, NotFoundError for an unknown one."""
        wanted = _id_of(character_id)
        with self._lock:
            if wanted not in self._characters:
                raise NotFoundError(f"no character {wanted!r} here", field="character_id")
            return self._characters[wanted]

    # --- handlers ---

    def _welcome(self, hello: Hello) -> Welcome:
        return Welcome(
            service="tracker",
            version=VERSION,
            instance_id="",
            default_plugin=self._trackers.default,
            plugins=self._trackers.specs(),
            state_endpoint=self.state_endpoint,
        )

    def _health(self, envelope: Envelope, message: Health) -> HealthReport:
        with self._lock:
            characters = list(self._characters.values())
        failures = sum(c.recorder.spill_failures for c in characters)
        return HealthReport(
            status="degraded" if failures else "ok",
            uptime_s=time.monotonic() - self._started_s,
            detail={
                "characters": len(characters),
                "max_characters": self.settings.max_characters,
                "realtime": sum(c.clock.pacing == "realtime" for c in characters),
                "missed_ticks": sum(c.clock.missed_ticks for c in characters),
                "pending": self._server.pending,
                "recording_bytes_in_memory": sum(c.recorder.memory_bytes for c in characters),
                "failed_spills": failures,
                **self.metrics.detail(),
            },
        )

    def _create(self, envelope: Envelope, message: CreateCharacter) -> StateFrame:
        character_id = _id_of(envelope.character_id)
        hosted = self._host(
            character_id,
            message.character,
            self._worlds.scene(message.scene, message.seed),
            self._trackers.get(message.tracker, message.character),
            message.pacing,
            message.seed,
            message.position_w_m,
            message.heading_rad,
        )
        self._admit(hosted)
        return self._paced(hosted)

    def _host(
        self,
        character_id: str,
        character: str,
        scene: Scene,
        tracker: Tracker,
        pacing: Pacing,
        seed: int,
        xy_w_m: tuple[float, float] = (0.0, 0.0),
        heading_rad: float = 0.0,
    ) -> HostedCharacter:
        with self._lock:
            if character_id in self._characters:
                raise ConflictError(f"character {character_id!r} exists already", field="character_id")
            if len(self._characters) >= self.settings.max_characters:
                raise OverloadedError(f"{len(self._characters)} characters are hosted here, no more fit")
            self._recordings += 1
            folder = self._spool_folder() / f"recording-{self._server.instance_id[:8]}-{self._recordings:05d}"
        simulation = self._worlds.simulation(character, scene, tracker, character_id, xy_w_m, heading_rad)
        recorder = Recorder(folder, self.settings.chunk_samples, self.settings.memory_chunks)
        return HostedCharacter(
            character_id,
            simulation,
            recorder,
            pacing,
            seed,
            self.settings,
            dump_folder(self.settings),
            self.metrics.ticked,
        )

    def _spool_folder(self) -> Path:
        assert self._spool is not None, "set by start()"
        return self._spool

    def _admit(self, hosted: HostedCharacter) -> None:
        with self._lock:
            if hosted.character_id in self._characters:
                raise ConflictError(f"character {hosted.character_id!r} exists already", field="character_id")
            self._characters[hosted.character_id] = hosted

    def _paced(self, hosted: HostedCharacter) -> StateFrame:
        """Put the character on the realtime clock or take it off, as its pacing says; its frame, published."""
        frame = hosted.frame()
        if hosted.clock.pacing == "realtime" and not hosted.clock.paused:
            self._clock.add(hosted)
        else:
            self._clock.remove(hosted.character_id)
        self._publish(frame)
        return frame

    def _close(self, envelope: Envelope, message: CloseCharacter) -> Ok:
        hosted = self.character(envelope.character_id)
        self._clock.remove(hosted.character_id)
        with self._lock:
            self._characters.pop(hosted.character_id, None)
        hosted.close()
        self.metrics.closed(hosted.character_id)
        return Ok()

    def _set_scene(self, envelope: Envelope, message: SetScene) -> StateFrame:
        hosted = self.character(envelope.character_id)
        old = hosted.simulation
        scene = self._worlds.scene(message.scene, hosted.seed)
        new = self._worlds.simulation(old.human.character.name, scene, old.tracker, hosted.character_id)
        return self._published(hosted.replace_simulation(new))

    def _set_object(self, envelope: Envelope, message: SetObject) -> StateFrame:
        return self._published(self.character(envelope.character_id).set_object(message))

    def _set_tracker(self, envelope: Envelope, message: SetTracker) -> Ok:
        hosted = self.character(envelope.character_id)
        hosted.set_tracker(self._trackers.get(message.tracker, hosted.simulation.human.character.name))
        return Ok()

    def _set_pacing(self, envelope: Envelope, message: SetPacing) -> StateFrame:
        hosted = self.character(envelope.character_id)
        hosted.set_pacing(message.pacing, message.paused)
        return self._paced(hosted)

    def _reset(self, envelope: Envelope, message: ResetCharacter) -> StateFrame:
        hosted = self.character(envelope.character_id)
        return self._published(hosted.reset(message.position_w_m, message.heading_rad))

    def _track(self, envelope: Envelope, message: Track) -> TrackReply:
        reply = self.character(envelope.character_id).track(message)
        said = fields(character=envelope.character_id, tick=reply.tick, enters_at_tick=reply.entered_tick)
        log.debug("plan %s", "taken" if reply.accepted else "dropped", extra=said)
        return reply

    def _step(self, envelope: Envelope, message: Step) -> StateFrame:
        return self._published(self.character(envelope.character_id).lockstep(message.ticks))

    def _observe(self, envelope: Envelope, message: Observe) -> StateFrame | Look:
        hosted = self.character(envelope.character_id)
        return hosted.frame() if message.since_tick is None else hosted.look(message.since_tick)

    def _get_ticks(self, envelope: Envelope, message: GetTicks) -> TickRange:
        return self.character(envelope.character_id).ticks(message)

    def _impulse(self, envelope: Envelope, message: Impulse) -> Ok:
        self.character(envelope.character_id).impulse(message.body, message.impulse_w_ns)
        return Ok()

    def _take_snapshot(self, envelope: Envelope, message: TakeSnapshot) -> Snapshot:
        return self.character(envelope.character_id).snapshot()

    def _restore(self, envelope: Envelope, message: Restore) -> StateFrame:
        character_id, meta = _id_of(envelope.character_id), message.meta
        check_format(meta)
        names = {}
        for key in ("character", "scene", "tracker", "pacing"):
            value = meta.get(key)
            if not isinstance(value, str):
                raise InvalidInputError(f"the snapshot does not say its {key}", field=f"meta.{key}", allowed="a name")
            names[key] = value
        tracker = self._trackers.get(names["tracker"], names["character"])
        scene = scene_from_data(meta.get("scene_document"))
        with self._lock:
            present = self._characters.get(character_id)
        if present is not None:
            if present.simulation.scene.scene != scene:
                other = present.simulation.scene.scene.name
                what = f"scene {other!r}" if other != scene.name else f"another draw of scene {other!r}"
                raise ConflictError(f"the character is in {what}", field="meta.scene", allowed=scene.name)
            present.restore(meta, message.state, message.buffers)
            present.set_tracker(tracker)
            return self._published(present.frame())
        pacing: Pacing = "realtime" if names["pacing"] == "realtime" else "lockstep"
        hosted = self._host(character_id, names["character"], scene, tracker, pacing, 0)
        try:
            hosted.restore(meta, message.state, message.buffers)
            self._admit(hosted)
        except BaseException:
            hosted.close()
            raise
        return self._paced(hosted)

    def _render(self, envelope: Envelope, message: Render) -> Future[Message]:
        job = video_job(self.character(envelope.character_id), message, self.settings)
        return self._videos.submit(self._video, job)

    def _video(self, job: VideoJob) -> Message:
        video = self._renderer.render(job)
        if len(video.mp4) > MAX_VIDEO_BYTES:
            raise InvalidInputError(
                f"the video has {len(video.mp4)} bytes",
                field="stop_tick",
                allowed=f"videos up to {MAX_VIDEO_BYTES} bytes",
            )
        return Video(renderer=video.renderer, note=video.note, mp4=np.frombuffer(video.mp4, dtype=np.uint8))

    def _published(self, frame: StateFrame) -> StateFrame:
        self._publish(frame)
        return frame

    def _publish(self, frame: StateFrame) -> None:
        self.metrics.framed(frame)
        if self._publisher is not None:
            self._publisher.publish(frame)


def _id_of(character_id: str | None) -> str:
    if not character_id:
        raise InvalidInputError("the envelope names no character", field="character_id", allowed="1 to 64 characters")
    return character_id
