"""The plug-in `dip`: plan requests in, clips of exact bone lengths out.

The prefix goes through the same G2R as in training, and targets are seen from the same frame, that of the last prefix
frame (REFERENCE 4.3).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from planner_service.dip.aiming import AIMED_STEPS, aimed, hands_of, toes_of
from planner_service.dip.batch import Batch
from planner_service.dip.conditions import JOINT_SLOTS
from planner_service.dip.deeds import Deed, deed_of, ranked, tries_of
from planner_service.dip.diffusion import Denoiser, cosine_schedule, respaced, sample, sample_some, spread_steps
from planner_service.dip.effort import EASIER_GUIDANCE, STANDS_MPS, eased, led_up_to, speed_mps, too_hard
from planner_service.dip.feet import walks, with_planted_feet
from planner_service.dip.floor import held_seated, is_floor_seat, way_down
from planner_service.dip.folded import Conditions, Denoising, FoldedDip
from planner_service.dip.manner import SWUNG_STEPS, Manner, manner_of, swung
from planner_service.dip.network import DipNetwork
from planner_service.dip.runtime import Runtime, choose_blocks, usual_steps
from planner_service.dip.weights import SHIPPED, DipWeights, load_weights
from planner_service.dip.wishes import read_wishes
from planner_service.text.encoder import CachedTextEncoder, TextEncoder, pad_tokens
from planner_service.text.known import KnownSentences, Nearest
from planner_service.text.meaning import MeaningHead
from planner_service.text.pretrained import minilm
from shared.errors import InvalidInputError, SimulationError
from shared.motion.features import (
    CONTACTS,
    features_to_global,
    global_to_features,
    root_state,
)
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest, TextRead

Array = npt.NDArray[np.float64]
VERSION = "1"
CHOICE_AFTER_CALLS = 3
"""Of several plans the most promising are chosen after so many calls of the network, at most half of all."""


class DipSettings(BaseModel):
    """How requests are turned into conditions.

    Attributes:
        guidance: classifier-free guidance scale on the text, where a request gives none and has no target, and its
            text means nothing that has a manner of its own (`manner.MANNERS`); less of it for a body that moves fast,
            see `eased`.
        target_guidance: the same for requests with a target of a joint, or with keyframes or a velocity that the
            weights take. Guidance pulls a plan toward what is typical of its text and so away from its target; 1 is
            none (and half the work).
        coarse_guidance: at most this in the first, noisiest `coarse_steps` of the diffusion, which decide speeds and
            places. Guided more there, a start from standing reaches a run within half a second, which no body can do
            (guidance within an interval: Kynkaanniemi et al. 2024). Later steps decide detail, as the swing of a wave,
            and are guided in full.
        step_m: a target farther than this (on the floor, from the root) is moved toward the root: what running covers
            in a full plan; proportionally less for earlier arrivals. Callers who want a natural walk hand over nearer
            targets (REFERENCE 3: 1.2 m a plan).
        steps: how many of the diffusion's steps are taken, spread evenly over them; at most all that were trained.
            None: see `runtime.usual_steps`.
        runtime, bf16: see `runtime.choose_blocks` (plans differ by rounding).
        threads: CPU threads of a runtime other than torch, whose threads belong to the process.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    guidance: float = Field(3.0, ge=0)
    target_guidance: float = Field(1.0, ge=0)
    coarse_guidance: float = Field(2.5, ge=0)
    coarse_steps: int = Field(3, ge=0)
    step_m: float = Field(5.0, gt=0)
    steps: int | None = Field(None, ge=1)
    runtime: Runtime = "auto"
    bf16: bool | None = None
    threads: int = Field(1, ge=1)


class DipPlanner:
    """The diffusion planner.

    Args:
        weights: from `load_weights`.
        encoder: the text encoder that the weights were trained with; cached here.
        settings: see DipSettings.
        known: the sentences that the weights were trained on; an unseen text is planned for as the one of them that
            it is taken for (`Plan.understood`). None where they are not known.
        dip: what runs the network in place of what the settings choose.
    """

    def __init__(
        self,
        weights: DipWeights,
        encoder: TextEncoder,
        settings: DipSettings | None = None,
        known: KnownSentences | None = None,
        dip: Denoising | None = None,
    ):
        self._config = weights.network.config
        self._normalizer = weights.normalizer
        if encoder.spec.name != self._config.text_encoder:
            raise InvalidInputError(
                f"these weights do not fit the text encoder {encoder.spec.name!r}",
                field="text_encoder",
                allowed=self._config.text_encoder,
            )
        self._texts = CachedTextEncoder(encoder)
        self._known = known
        self._settings = settings or DipSettings()
        self._dip: Denoising = dip or folded(weights.network, self._settings)
        trained = self._config.steps
        wanted = self._settings.steps or usual_steps(trained, self._settings.bf16)
        self._steps = spread_steps(trained, min(wanted, trained))
        self._schedule = respaced(cosine_schedule(trained), self._steps)
        self._weights_id = weights.sha256[:12]
        self._spec = PlannerSpec(
            name="dip",
            version=VERSION,
            weights_sha256=weights.sha256,
            skeleton=CANONICAL.id,
            fps=PLANNER_FPS,
            prefix_frames=self._config.prefix_frames,
            plan_frames=self._config.plan_frames,
            target_joints=JOINT_SLOTS,
            conditions=("text", "target", "heading", *self._config.extra_conditions),
        )

    @classmethod
    def load(cls, path: Path | None = None, settings: DipSettings | None = None) -> DipPlanner:
        """With weights from a file (else the shipped ones) and MiniLM."""
        encoder = minilm()
        known = KnownSentences.load(head=MeaningHead.load(encoder.config, encoder.below))
        return cls(load_weights(path or SHIPPED), encoder, settings, known)

    def read_text(self, text: str) -> TextRead:
        """The training sentence nearest to a text."""
        found = self._read(text)
        if found is None:
            return TextRead()
        return TextRead(nearest=found.sentence, similarity=round(found.similarity, 4), far=found.far)

    def _read(self, text: str | None) -> Nearest | None:
        return None if text is None or self._known is None else self._known.nearest(text, self._texts)

    @property
    def runs_in(self) -> str:
        """By what, how precisely and in how many steps plans are made."""
        return f"{self._dip.name}, {len(self._steps)} steps"

    @property
    def spec(self) -> PlannerSpec:
        """What this planner is and takes."""
        return self._spec

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request, in order; those too hard for legs are made a second time (`timings_ms` has both),
        what most plans do by half is planned for several times (`deeds`), and who sits on the floor stays so (`floor`).

        Raises:
            InvalidInputError: a prefix or horizon of the wrong length.
            SimulationError: the network gave a plan that is not finite.
        """
        for request in requests:
            self._check(request)
        meant = [self._meaning(request) for request in requests]
        deeds = [
            None if speed_mps(r) > STANDS_MPS else deed_of(meaning, r)
            for r, meaning in zip(requests, meant, strict=True)
        ]
        requests = [led_up_to(request, meaning) for request, meaning in zip(requests, meant, strict=True)]
        floor = [is_floor_seat(request) for request in requests]
        requests = [way_down(r) if low else r for r, low in zip(requests, floor, strict=True)]
        plain = iter(self._plans([r for r, found in zip(requests, deeds, strict=True) if found is None]))
        plans = [
            next(plain) if found is None else self._deed(request, *found)
            for request, found in zip(requests, deeds, strict=True)
        ]
        return [held_seated(r, p) if low else p for r, p, low in zip(requests, plans, floor, strict=True)]

    def _meaning(self, request: PlanRequest) -> str | None:
        read = self._read(request.text)
        return None if read is None else read.meaning

    def _deed(self, request: PlanRequest, deed: Deed, side: str) -> Plan:
        """The best of several plans: those that promise less are given up on the way, all but one before the last,
        exact call of the network."""
        began, done, last = time.monotonic(), 0, len(self._steps) - 1
        tried = tries_of(request, root_state(request.prefix_positions_w_m[-1]), deed, side)
        batch, begun = self._batch(tried), None
        with torch.inference_mode():
            for until, kept in ((min(CHOICE_AFTER_CALLS, len(self._steps) // 2), deed.kept), (last, 1)):
                foreseen, begun = sample_some(self._schedule, self._denoiser(batch), batch.noise, until, begun, done)
                best = ranked(request, deed, side, self._motions(batch, self._features(foreseen)))[:kept]
                tried, batch, begun, done = [tried[i] for i in best], batch.only(best), begun[best], until
            clean = sample(self._schedule, self._denoiser(batch), batch.noise, begun, done)
        sampled = time.monotonic()
        plan = self._to_plan(tried[0], self._features(clean)[0], batch, 0)
        return plan.model_copy(
            update={
                "seed": request.seed,
                "understood": batch.taken_as[0] if tried[0].text == request.text else tried[0].text,
                "timings_ms": {
                    **batch.timings_ms,
                    "diffusion": (sampled - began) * 1e3 - sum(batch.timings_ms.values()),
                    "decode": (time.monotonic() - sampled) * 1e3,
                },
            }
        )

    def _batch(self, requests: list[PlanRequest]) -> Batch:
        """All that sampling needs of some requests."""
        began = time.monotonic()
        # All tries of a deed go on from one prefix.
        shown = {id(r.prefix_positions_w_m): r.prefix_positions_w_m for r in requests}
        known = {key: global_to_features(p.astype(np.float64), PLANNER_FPS) for key, p in shown.items()}
        prefixes = [known[id(r.prefix_positions_w_m)] for r in requests]
        states = [root_state(request.prefix_positions_w_m[-1]) for request in requests]
        wishes = read_wishes(requests, states, self._config, self._settings.step_m)
        encoded = time.monotonic()
        read = [self._read(request.text) for request in requests]
        taken_as = [None if near is None else near.taken_as for near in read]
        text, mask = self._encode([taken or r.text for taken, r in zip(taken_as, requests, strict=True)])
        return Batch(
            prefixes=prefixes,
            states=states,
            wishes=wishes,
            taken_as=taken_as,
            prefix=self._normalizer.normalize(torch.from_numpy(np.stack(prefixes)).float()),
            text=text,
            mask=mask,
            manners=[self._manner(r, near, p) for r, near, p in zip(requests, read, wishes.placed, strict=True)],
            noise=torch.stack([self._noise(r.seed) for r in requests], dim=1),
            timings_ms={"features": (encoded - began) * 1e3, "text": (time.monotonic() - encoded) * 1e3},
        )

    def _plans(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request, of one sample or, where that was too hard, of a second one."""
        if not requests:
            return []
        batch = self._batch(requests)
        began = time.monotonic()
        guidance = [manner.guidance for manner in batch.manners]
        with torch.inference_mode():
            clean = sample(self._schedule, self._denoiser(batch), batch.noise)
        planned = self._features(clean)
        sampled = time.monotonic()
        plans = [
            self._to_plan(request, features, batch, i)
            for i, (request, features) in enumerate(zip(requests, planned, strict=True))
        ]
        timings = {
            **batch.timings_ms,
            "diffusion": (sampled - began) * 1e3,
            "decode": (time.monotonic() - sampled) * 1e3,
        }
        plans = [
            plan.model_copy(update={"timings_ms": timings, "understood": taken})
            for plan, taken in zip(plans, batch.taken_as, strict=True)
        ]
        hard = [i for i, plan in enumerate(plans) if too_hard(requests[i], plan, guidance[i])]
        again = self._plans([requests[i].model_copy(update={"guidance": EASIER_GUIDANCE}) for i in hard])
        for i, plan in zip(hard, again, strict=True):
            both = {name: timings[name] + took for name, took in plan.timings_ms.items()}
            plans[i] = plan.model_copy(update={"timings_ms": both})
        return plans

    def _features(self, clean: Tensor) -> Array:
        return self._normalizer.denormalize(clean).double().numpy()

    def _motions(self, batch: Batch, features: Array) -> list[Array]:
        """(N, 22, 3) of each plan of a batch, as the network shows it."""
        rows = zip(batch.prefixes, features, batch.states, strict=True)
        return [features_to_global(np.concatenate([p[-1:], f]), PLANNER_FPS, s)[1:] for p, f, s in rows]

    def _manner(self, request: PlanRequest, read: Nearest | None, placed: bool) -> Manner:
        coarse = self._settings.coarse_guidance
        if request.guidance is not None:
            return Manner(request.guidance, coarse)
        if placed:
            return Manner(self._settings.target_guidance, coarse)
        usual, speed = Manner(self._settings.guidance, coarse), speed_mps(request)
        manner = usual if read is None or speed > STANDS_MPS else manner_of(read.meaning, usual)
        return replace(manner.after(request.prefix_positions_w_m), guidance=eased(manner.guidance, speed))

    def _check(self, request: PlanRequest) -> None:
        want, most = self._config.prefix_frames, self._config.plan_frames
        if len(request.prefix_positions_w_m) != want:
            raise InvalidInputError(
                f"the prefix has {len(request.prefix_positions_w_m)} frames",
                field="prefix_positions_w_m",
                allowed=f"{want} frames",
            )
        if request.horizon_frames > most:
            raise InvalidInputError(
                f"horizon of {request.horizon_frames} frames", field="horizon_frames", allowed=f"1..{most}"
            )

    def _encode(self, texts: Sequence[str | None]) -> tuple[Tensor, Tensor]:
        """Padded token features (B, L, D) and mask (B, L); no tokens for None."""
        nothing = np.zeros((0, self._config.text_dim), np.float32)
        known = self._texts.encode([t for t in texts if t is not None])
        found = iter(known)
        features, mask = pad_tokens([nothing if t is None else next(found) for t in texts], self._config.text_dim)
        return torch.from_numpy(features), torch.from_numpy(mask)

    def _noise(self, seed: int) -> Tensor:
        """(steps, N, F) of one request: its own generator, so that a batch does not change a plan."""
        generator = torch.Generator().manual_seed(seed)
        shape = (len(self._steps), self._config.plan_frames, self._config.features)
        return torch.randn(shape, generator=generator)

    def _denoiser(self, batch: Batch) -> Denoiser:
        """The network for a batch, guided and aimed: clean plans (B, N, F) from noisy ones at a step. Rows that need it
        run twice in one batch, with and without text."""
        manners, wishes = batch.manners, batch.wishes
        guidance = torch.tensor([manner.guidance for manner in manners])
        mask = batch.mask & (guidance != 0.0)[:, None]  # a guidance of zero: the text does not count at all
        both = torch.nonzero(mask.any(-1) & (guidance != 1.0)).flatten()
        fine = guidance[both][:, None, None]
        coarse = torch.minimum(fine, torch.tensor([manner.coarse for manner in manners])[both][:, None, None])
        # Fewer steps than were trained swing as much in all.
        more = (1 + torch.tensor([manner.swing for manner in manners])) ** (self._config.steps / len(self._steps)) - 1
        smooth = torch.tensor([float(manner.lively_mps is not None) for manner in manners])
        swings = bool((more + smooth).any())
        first_fine = self._config.steps - self._settings.coarse_steps
        given = Conditions(batch.prefix, wishes.targets, batch.text, mask, wishes.keyframes, wishes.velocity)
        state = self._dip.begin(given, both, self._steps)

        def denoise(x: Tensor, position: int) -> Tensor:
            out = self._dip.denoise(state, x, position)
            guided, free = out[: len(mask)], out[len(mask) :]
            scale = fine if self._steps[position] < first_fine else coarse
            guided[both] = free + scale * (guided[both] - free)
            if swings and self._steps[position] < SWUNG_STEPS:
                guided = swung(guided, more, smooth)
            if not wishes.aims or self._steps[position] >= AIMED_STEPS:
                return guided
            return self._normalizer.normalize(aimed(self._normalizer.denormalize(guided), wishes.aims))

        return denoise

    def _to_plan(self, request: PlanRequest, planned: Array, batch: Batch, row: int) -> Plan:
        """World clip of one sample, the `row` of its batch, its bones of exact length."""
        wishes = batch.wishes
        features = np.concatenate([batch.prefixes[row][-1:], planned[: request.horizon_frames]])
        if not np.isfinite(features).all():
            raise SimulationError("the diffusion planner gave values that are not finite")
        positions = features_to_global(features, PLANNER_FPS, batch.states[row])
        clip = with_planted_feet(
            positions, features[:, CONTACTS], PLANNER_FPS, hands_of(wishes.aims, row), toes_of(wishes.aims, row),
            walking=not request.targets and walks(positions, PLANNER_FPS),
        )  # fmt: skip
        return Plan(
            planner="dip",
            weights_id=self._weights_id,
            skeleton=CANONICAL.id,
            start_tick=request.start_tick,
            positions_w_m=clip.positions_w_m,
            rotations_6d=clip.rotations_6d,
            seed=request.seed,
            ignored_conditions=wishes.ignored[row],
            guidance=batch.manners[row].guidance if request.text is not None else None,
        )


def folded(network: DipNetwork, settings: DipSettings) -> FoldedDip:
    """The network as the settings want it run."""
    chosen = choose_blocks(network, settings.runtime, settings.bf16, settings.threads)
    return FoldedDip(network, chosen.quick, chosen.exact, chosen.name)
