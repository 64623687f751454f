"""Everything that runs: characters, episodes and the services they run on."""

from __future__ import annotations

import asyncio
import logging
import uuid
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.episode import EpisodeRunner
from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.core.events import EventLog, captions_of
from orchestrator.core.loop import trace_from
from orchestrator.core.services import Services, Slot
from orchestrator.core.swap import check_drives, check_spec, swap
from orchestrator.core.tape import MEGABYTE, Backlog, Tape
from orchestrator.rest import Event
from orchestrator.store.interface import Store, StoreReader
from orchestrator.store.recordings import RecordingFiles, write_atomically
from orchestrator.store.resume import from_bytes
from shared.errors import ConflictError, InvalidInputError, MotionLoopError, NotFoundError, OverloadedError
from shared.motion.characters import build
from shared.protocol.control import Ok
from shared.protocol.messages import CloseCharacter, Render, Video
from shared.protocol.security import CurveKeys
from shared.protocol.transport import Kind
from shared.scenes.schema import Scene

log = logging.getLogger(__name__)

KEPT_FOR_VIDEO = 8
OUTCOME_PATIENCE_S = 5.0
DISK_RETRY_S, LONGEST_RETRY_S = 1.0, 60.0
RENDER_TIMEOUT_S = 900.0


class LiveEpisode:
    """An episode that runs, or has just ended and whose character is still there to be filmed."""

    def __init__(self, runner: EpisodeRunner, tape: Tape):
        self.runner = runner
        self.tape = tape
        self.outcome: EpisodeOutcome | None = None
        self.task: asyncio.Task[None] | None = None
        self.written = False
        """Whether its recording is the one file that it should be."""


class Orchestrator:
    """Makes, finds and ends characters and episodes.

    Args:
        services: planner and tracker to start with.
        store: where everything is kept.
        max_running: characters and episodes that may run at once; more are refused as overloaded.
        curve: keys for services on other machines.
        unwritten_mb: recordings that a disk refuses are held in memory up to this; with more, no episode is begun.
    """

    def __init__(
        self,
        services: Services,
        store: Store,
        max_running: int = 64,
        curve: CurveKeys | None = None,
        unwritten_mb: float = 256.0,
    ):
        self.services = services
        self.store = store
        self.reader = StoreReader(store)
        self.files = RecordingFiles(store.recordings)
        self.characters: dict[str, CharacterSession] = {}
        self.episodes: dict[str, LiveEpisode] = {}
        self.backlog = Backlog(round(unwritten_mb * MEGABYTE))
        self._max_running = max_running
        self._curve = curve
        self.observers: list[Callable[[Event], None]] = []
        """Called with every event of every character and episode; they must not block."""
        self._retired: list[Slot] = []
        self._video_lock = asyncio.Lock()

    async def recover(self) -> list[str]:
        """After a start: take up the episodes that an earlier process left running; those that cannot be are marked as
        interrupted. Recordings left in parts are joined. Returns the interrupted ones."""
        episodes, characters = await asyncio.to_thread(self.store.left_running)
        interrupted = [episode_id for episode_id in episodes if not await self._take_up(episode_id)]
        await asyncio.to_thread(self.store.mark_interrupted, interrupted, characters)
        for episode_id in await asyncio.to_thread(self.files.unfinished):
            if episode_id not in self.episodes:
                await asyncio.to_thread(self.files.finish, episode_id)
        over, _ = await self.reader.episodes(None, 2 * KEPT_FOR_VIDEO, 0)
        filmed = [str(row["id"]) for row in over if row["id"] not in self.episodes]
        for character_id in {*interrupted, *characters, *filmed}:
            self.services.leave_all_behind(character_id)
        return interrupted

    async def _take_up(self, episode_id: str) -> bool:
        """Go on with an episode of an earlier process; False where what that needs is not there."""
        try:
            data = await asyncio.to_thread(self.files.resume, episode_id)
            if data is None:
                return False
            kept, state = await asyncio.to_thread(from_bytes, data)
            spec = EpisodeSpec.model_validate((await self.reader.episode(episode_id))["spec"])
            recorded = await asyncio.to_thread(self.files.recorded, episode_id, kept.tick)
            live = self._live(episode_id, spec, await self.reader.events(episode_id), kept.tick + 1)
            live.runner.take_up(state, kept, trace_from(0, recorded.arrays, recorded.objects))
        except (MotionLoopError, OSError, ValueError, KeyError) as error:
            log.warning("episode %s cannot be taken up: %s", episode_id, error)
            self.episodes.pop(episode_id, None)
            return False
        self._begin(live)
        return True

    async def close(self) -> None:
        """End everything: episodes are left to the next server, characters closed, the store written."""
        tasks = [episode.task for episode in self.episodes.values() if episode.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for character in list(self.characters.values()):
            await character.close()
            self.store.character_ended(character.character_id, "closed")
        for slot in self._retired:
            await slot.client.close()
        await self.services.close()
        await self.reader.close()

    def end_streams(self) -> None:
        """End whatever is streamed to viewers: the server is about to end."""
        for character in self.characters.values():
            character.events.close()
            character.states.close()
        for episode in self.episodes.values():
            episode.runner.events.close()
            episode.runner.session.states.close()

    # --- characters ---

    async def create_character(self, spec: CharacterSpec) -> CharacterSession:
        """Make a character and let it run."""
        self._check_room()
        self._check_plugins(spec.character, spec.planner, spec.tracker)
        character_id = str(uuid.uuid4())
        session = CharacterSession(character_id, spec, self.services, EventLog(self._sink(character_id)))
        self.store.character_started(character_id, spec.model_dump(mode="json"))
        try:
            await session.start()
        except MotionLoopError:
            self.store.character_ended(character_id, "failed")
            raise
        self.characters[character_id] = session
        return session

    def character(self, character_id: str) -> CharacterSession:
        """A running character; raises NotFoundError."""
        if character_id not in self.characters:
            raise NotFoundError(f"there is no character {character_id}", field="id")
        return self.characters[character_id]

    async def delete_character(self, character_id: str) -> None:
        """End a character."""
        session = self.character(character_id)
        del self.characters[character_id]
        await session.close()
        self.store.character_ended(character_id, "closed")

    # --- episodes ---

    def start_episode(self, spec: EpisodeSpec) -> str:
        """Start an episode in the background; returns its id."""
        self._check_room()
        self.backlog.check_room()
        self._check_plugins(spec.character, spec.planner, spec.tracker)
        self.services.scenes.for_tracker(spec.scene, spec.seed)  # a wrong scene is refused now, not in the background
        scene = self.services.scenes.chosen(spec.scene, spec.seed)
        for task in spec.tasks:
            task.check(scene)
        episode_id = str(uuid.uuid4())
        live = self._live(episode_id, spec)
        self.store.episode_started(episode_id, spec, self.service_report())
        self._begin(live)
        return episode_id

    def live_episode(self, episode_id: str) -> LiveEpisode | None:
        """The episode, if it runs or has just ended."""
        return self.episodes.get(episode_id)

    async def running_episode(self, episode_id: str) -> EpisodeRunner:
        """An episode that runs; raises NotFoundError, or ConflictError for one that is over."""
        live = self.episodes.get(episode_id)
        if live is None or live.outcome is not None:
            row = await self.reader.episode(episode_id)
            raise ConflictError(f"the episode is {row['status']}", field="id", allowed="one that runs")
        return live.runner

    async def cancel_or_delete_episode(self, episode_id: str) -> str:
        """Cancel a running episode (`cancelled`), or delete one that is over (`deleted`)."""
        live = self.episodes.get(episode_id)
        if live is not None and live.outcome is None:
            live.runner.cancel()
            return "cancelled"
        await self.reader.episode(episode_id)
        if live is not None:
            await self._let_go(episode_id)
        self.store.delete_episode(episode_id)
        await asyncio.to_thread(self.files.delete, episode_id)
        return "deleted"

    async def video(self, episode_id: str) -> bytes:
        """The episode as MP4, rendered by the tracker once and kept.

        Raises ConflictError while it runs, or when its character is gone and no video was made.
        """
        path = self.files.path(episode_id, ".mp4")
        async with self._video_lock:
            if path.exists():
                return await asyncio.to_thread(path.read_bytes)
            live = self.episodes.get(episode_id)
            if live is None:
                await self.reader.episode(episode_id)
                raise ConflictError(
                    "the character of this episode is gone, it can no longer be filmed",
                    field="id",
                    allowed=f"one of the last {KEPT_FOR_VIDEO} episodes",
                )
            if live.outcome is None:
                raise ConflictError("the episode is still running", field="id")
            request = Render(
                start_tick=live.runner.session.log_from_tick,
                stop_tick=live.runner.tick or None,
                captions=captions_of(live.runner.events.since(0)),
            )
            video = await live.runner.session.loop.ask_tracker(Video, request, RENDER_TIMEOUT_S)
            live.runner.events.emit("video", live.runner.tick, renderer=video.renderer, note=video.note)
            data = np.asarray(video.mp4, dtype=np.uint8).tobytes()
            await asyncio.to_thread(write_atomically, path, data)
            return data

    async def episode_scene(self, episode_id: str) -> Scene | None:
        """The scene of an episode as its seed made it; None where only the tracker knows it. Raises NotFoundError."""
        if episode_id in self.episodes:
            return self.episodes[episode_id].runner.session.scene
        row = await self.reader.episode(episode_id)
        spec = EpisodeSpec.model_validate(row["spec"])
        return self.services.scenes.chosen(spec.scene, spec.seed)

    # --- services ---

    def service_report(self) -> dict[str, Any]:
        """What is in the slots."""
        return {
            kind: {
                "endpoint": slot.endpoint,
                "version": slot.welcome.version,
                "plugin": slot.plugin_name,
                "spec": slot.spec(),
                "plugins": [str(p.get("name")) for p in slot.welcome.plugins],
            }
            for kind, slot in (("planner", self.services.planner), ("tracker", self.services.tracker))
        }

    async def swap(self, kind: Kind, endpoint: str | None, plugin: str | None) -> dict[str, Any]:
        """Hot swap; running characters take the new one up at their next plan. Raises, changing nothing, if unfit."""
        old = await swap(self.services, kind, endpoint, plugin, self._curve)
        new = self.services.planner if kind == "planner" else self.services.tracker
        if old.client is not new.client:
            self._retired.append(old)  # requests under way still use it
        said = {"service": kind, "endpoint": new.endpoint, "plugin": new.plugin_name}
        for session in self.characters.values():
            session.events.emit("swap", session.state.tick, **said)
        for live in self.episodes.values():
            if live.outcome is None:
                live.runner.events.emit("swap", live.runner.tick, **said)
        return dict(self.service_report()[kind])

    # --- inside ---

    def _sink(self, owner: str) -> Callable[[Event], None]:
        def take(event: Event) -> None:
            for observe in self.observers:
                observe(event)
            self.store.event(owner, event)

        return take

    def _check_room(self) -> None:
        running = len(self.characters) + sum(1 for e in self.episodes.values() if e.outcome is None)
        if running >= self._max_running:
            raise OverloadedError(f"{running} characters are running already", allowed=f"at most {self._max_running}")

    def _check_plugins(self, character: str, planner: str | None, tracker: str | None) -> None:
        build(character)
        for field, name, slot in (
            ("planner", planner, self.services.planner),
            ("tracker", tracker, self.services.tracker),
        ):
            if name is not None and not slot.spec(name):
                offered = ", ".join(str(p.get("name")) for p in slot.welcome.plugins)
                raise InvalidInputError(f"the {field} service has no {name!r}", field=field, allowed=offered)
        check_spec(self.services.planner)
        check_drives(self.services.tracker, tracker, character)

    def _live(
        self, episode_id: str, spec: EpisodeSpec, earlier: Sequence[Event] = (), recorded_to: int = 0
    ) -> LiveEpisode:
        """An episode with its tape, not yet running."""
        live: LiveEpisode
        events = EventLog(self._sink(episode_id), earlier)
        runner = EpisodeRunner(episode_id, spec, self.services, events, lambda cycle: live.tape.wind(cycle))
        live = LiveEpisode(runner, Tape(runner, self.files, self.backlog, recorded_to))
        self.episodes[episode_id] = live
        return live

    def _begin(self, live: LiveEpisode) -> None:
        live.task = asyncio.create_task(self._run(live), name=f"episode-{live.runner.episode_id}")

    async def _run(self, live: LiveEpisode) -> None:
        runner = live.runner
        try:
            outcome = await runner.run()
        except asyncio.CancelledError:  # the server ends: the next one takes the episode up
            await live.tape.leave()
            raise
        except Exception as error:  # a bug must not leave an episode that never ends
            log.exception("episode %s broke", runner.episode_id)
            outcome = EpisodeOutcome(
                status="failed", reason=f"internal: {type(error).__name__}: {error}", success=False,
                results=runner.results, ticks=runner.tick, plans=runner.session.loop.plans_made, missed_ticks=0,
            )  # fmt: skip
        written = await self._finished(live)
        self.store.episode_ended(runner.episode_id, outcome)
        await self.reader.written(OUTCOME_PATIENCE_S)  # who is told of the end may rely on it
        live.outcome = outcome
        runner.events.emit("end", runner.tick, status=outcome.status, success=outcome.success, reason=outcome.reason)
        runner.events.close()
        runner.session.states.close()
        pause_s = DISK_RETRY_S
        while not written:
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_RETRY_S)
            written = await self._finished(live)
        await live.tape.drop()
        live.written = True
        over = [key for key, episode in self.episodes.items() if episode.written]
        for episode_id in over[:-KEPT_FOR_VIDEO]:
            await self._let_go(episode_id)

    async def _finished(self, live: LiveEpisode) -> bool:
        """Whether its recording is one file; whatever hinders that, the episode ends."""
        try:
            return await live.tape.finish(live.runner.tick + 1)
        except Exception:
            log.exception("the recording of episode %s cannot be made", live.runner.episode_id)
            return False

    async def _let_go(self, episode_id: str) -> None:
        live = self.episodes.pop(episode_id)
        if live.task is not None and live.task is not asyncio.current_task():
            live.task.cancel()  # one that still waits for the disk would make the recording again
        live.tape.discard()
        if live.runner.session.created:
            try:
                await live.runner.session.loop.ask_tracker(Ok, CloseCharacter())
            except MotionLoopError as error:
                log.warning("the character of episode %s could not be closed: %s", episode_id, error)
