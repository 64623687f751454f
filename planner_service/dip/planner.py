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
from planner_service.dip.conditions import JOINT_SLOTS
from planner_service.dip.deeds import Deed, best_of, deed_of, tries_of
from planner_service.dip.diffusion import cosine_schedule, respaced, sample, spread_steps
from planner_service.dip.feet import with_planted_feet
from planner_service.dip.floor import held_seated, is_floor_seat, way_down
from planner_service.dip.folded import Conditions, Denoising, FoldedDip
from planner_service.dip.manner import SWUNG_STEPS, Manner, manner_of, swung
from planner_service.dip.network import DipNetwork
from planner_service.dip.runtime import Runtime, choose_blocks, usual_steps
from planner_service.dip.weights import SHIPPED, DipWeights, load_weights
from planner_service.dip.wishes import Wishes, read_wishes
from planner_service.text.encoder import CachedTextEncoder, TextEncoder, pad_tokens
from planner_service.text.known import KnownSentences, Nearest
from planner_service.text.pretrained import minilm
from shared.errors import InvalidInputError, SimulationError
from shared.motion.features import (
    CONTACTS,
    RootState,
    features_to_global,
    global_to_features,
    root_state,
)
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest, TextRead

Array = npt.NDArray[np.float64]
VERSION = "1"


EASED_MPS = (1.2, 2.0)
"""Speeds between which guidance fades to none."""
STANDS_MPS = 0.6
"""Whoever goes faster comes to a stand first, in the usual manner: less guided, a runner runs on with waving arms."""
SPEED_FRAMES = 4


def speed_mps(request: PlanRequest) -> float:
    """How fast the pelvis goes over the floor at the end of a request's prefix."""
    root = request.prefix_positions_w_m[-SPEED_FRAMES - 1 :, 0, :2].astype(np.float64)
    return float(np.linalg.norm(root[-1] - root[0])) * PLANNER_FPS / max(len(root) - 1, 1)


def eased(guidance: float, speed_mps: float) -> float:
    """Guidance for a body at a speed: above 1 it fades to 1 (none) between EASED_MPS.

    Guidance pulls toward what is typical of a text, and what is typical of waving or jumping on the spot is to stand:
    of twelve runners at 2.5 m/s that were told to wave, plans with guidance 5 stopped the pelvis over the feet within
    half a second, which throws a body, those with 1 ran on for 0.4 s and slowed down over the next half.
    """
    low, high = EASED_MPS
    share = min(max((speed_mps - low) / (high - low), 0.0), 1.0)
    return guidance if guidance <= 1.0 else guidance + share * (1.0 - guidance)


EASIER_GUIDANCE = 1.5
LEGS_MPS2 = 3.5
"""A plan that changes the pelvis' speed faster is made again with less guidance, unless the request gives its own.
Eight bodies that stood and were told to run had plans that gained 4.0 m/s2 (median) with guidance 5, 3.1 with 1.5."""
SPAN_FRAMES = 6


def hardest_mps2(positions_w_m: npt.NDArray[np.floating]) -> float:
    """Fastest change of the pelvis' speed over the floor, over SPAN_FRAMES, in motion (T, J, 3) at PLANNER_FPS."""
    step = np.linalg.norm(np.diff(positions_w_m[:, 0, :2].astype(np.float64), axis=0), axis=-1) * PLANNER_FPS
    smooth = np.convolve(step, np.ones(3) / 3, "valid")
    if len(smooth) <= SPAN_FRAMES:
        return 0.0
    return float(np.abs(smooth[SPAN_FRAMES:] - smooth[:-SPAN_FRAMES]).max()) * PLANNER_FPS / SPAN_FRAMES


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
        self._schedule = respaced(cosine_schedule(self._config.steps), self._steps)
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
        return cls(load_weights(path or SHIPPED), minilm(), settings, KnownSentences.load())

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
        deeds = [None if speed_mps(request) > STANDS_MPS else self._deed(request) for request in requests]
        floor = [is_floor_seat(request) for request in requests]
        requests = [way_down(r) if low else r for r, low in zip(requests, floor, strict=True)]
        tried = [
            [request] if found is None else tries_of(request, root_state(request.prefix_positions_w_m[-1]), *found)
            for request, found in zip(requests, deeds, strict=True)
        ]
        made = iter(self._plans([told for each in tried for told in each]))
        own = [[(told, next(made)) for told in each] for each in tried]
        plans = [
            each[0][1] if found is None else best_of(request, *found, each)
            for request, found, each in zip(requests, deeds, own, strict=True)
        ]
        return [held_seated(r, p) if low else p for r, p, low in zip(requests, plans, floor, strict=True)]

    def _deed(self, request: PlanRequest) -> tuple[Deed, str] | None:
        read = self._read(request.text)
        return None if read is None else deed_of(read.meaning, request)

    def _plans(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request, of one sample or, where that was too hard, of a second one."""
        if not requests:
            return []
        began = time.monotonic()
        prefixes = [
            global_to_features(request.prefix_positions_w_m.astype(np.float64), PLANNER_FPS) for request in requests
        ]
        states = [root_state(request.prefix_positions_w_m[-1]) for request in requests]
        wishes = read_wishes(requests, states, self._config, self._settings.step_m)
        encoded = time.monotonic()
        read = [self._read(request.text) for request in requests]
        taken_as = [None if near is None else near.taken_as for near in read]
        text, mask = self._encode([taken or r.text for taken, r in zip(taken_as, requests, strict=True)])
        embedded = time.monotonic()
        prefix = self._normalizer.normalize(torch.from_numpy(np.stack(prefixes)).float())
        manners = [self._manner(r, near, p) for r, near, p in zip(requests, read, wishes.placed, strict=True)]
        guidance = [manner.guidance for manner in manners]
        noise = torch.stack([self._noise(r.seed) for r in requests], dim=1)
        planned = self._denormalized(noise, prefix, wishes, text, mask, manners)
        sampled = time.monotonic()
        plans = [
            self._to_plan(request, features, prefixes[i], states[i], wishes, i, guidance[i])
            for i, (request, features) in enumerate(zip(requests, planned, strict=True))
        ]
        timings = {
            "features": (encoded - began) * 1e3,
            "text": (embedded - encoded) * 1e3,
            "diffusion": (sampled - embedded) * 1e3,
            "decode": (time.monotonic() - sampled) * 1e3,
        }
        plans = [
            plan.model_copy(update={"timings_ms": timings, "understood": taken})
            for plan, taken in zip(plans, taken_as, strict=True)
        ]
        hard = [i for i, plan in enumerate(plans) if self._too_hard(requests[i], plan, guidance[i])]
        again = self._plans([requests[i].model_copy(update={"guidance": EASIER_GUIDANCE}) for i in hard])
        for i, plan in zip(hard, again, strict=True):
            both = {name: timings[name] + took for name, took in plan.timings_ms.items()}
            plans[i] = plan.model_copy(update={"timings_ms": both})
        return plans

    @staticmethod
    def _too_hard(request: PlanRequest, plan: Plan, guidance: float) -> bool:
        """Whether legs may not follow a plan, and less guidance may help."""
        if request.guidance is not None or request.text is None or guidance <= EASIER_GUIDANCE:
            return False
        motion = np.concatenate([request.prefix_positions_w_m[-SPAN_FRAMES:], plan.positions_w_m])
        return hardest_mps2(motion) > LEGS_MPS2

    def _manner(self, request: PlanRequest, read: Nearest | None, placed: bool) -> Manner:
        coarse = self._settings.coarse_guidance
        if request.guidance is not None:
            return Manner(request.guidance, coarse)
        if placed:
            return Manner(self._settings.target_guidance, coarse)
        usual, speed = Manner(self._settings.guidance, coarse), speed_mps(request)
        manner = usual if read is None or speed > STANDS_MPS else manner_of(read.meaning, usual)
        return replace(manner, guidance=eased(manner.guidance, speed))

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

    def _denormalized(
        self, noise: Tensor, prefix: Tensor, wishes: Wishes, text: Tensor, mask: Tensor, manners: Sequence[Manner]
    ) -> npt.NDArray[np.float64]:
        """(B, N, F) features of guided samples; rows that need it run twice in one batch, with and without text."""
        guidance = torch.tensor([manner.guidance for manner in manners])
        mask = mask & (guidance != 0.0)[:, None]  # a guidance of zero: the text does not count at all
        both = torch.nonzero(mask.any(-1) & (guidance != 1.0)).flatten()
        fine = guidance[both][:, None, None]
        coarse = torch.minimum(fine, torch.tensor([manner.coarse for manner in manners])[both][:, None, None])
        # Fewer steps than were trained swing as much in all.
        more = (1 + torch.tensor([manner.swing for manner in manners])) ** (self._config.steps / len(self._steps)) - 1
        first_fine = self._config.steps - self._settings.coarse_steps
        with torch.inference_mode():
            given = Conditions(prefix, wishes.targets, text, mask, wishes.keyframes, wishes.velocity)
            state = self._dip.begin(given, both, self._steps)

            def denoise(x: Tensor, position: int) -> Tensor:
                out = self._dip.denoise(state, x, position)
                guided, free = out[: len(mask)], out[len(mask) :]
                scale = fine if self._steps[position] < first_fine else coarse
                guided[both] = free + scale * (guided[both] - free)
                if self._steps[position] < SWUNG_STEPS and bool(more.any()):
                    guided = swung(guided, more)
                if not wishes.aims or self._steps[position] >= AIMED_STEPS:
                    return guided
                return self._normalizer.normalize(aimed(self._normalizer.denormalize(guided), wishes.aims))

            planned = self._normalizer.denormalize(sample(self._schedule, denoise, noise))
        return planned.double().numpy()

    def _to_plan(
        self,
        request: PlanRequest,
        planned: Array,
        prefix: Array,
        state: RootState,
        wishes: Wishes,
        row: int,
        guidance: float,
    ) -> Plan:
        """World clip of one sample, the `row` of its batch, its bones of exact length."""
        features = np.concatenate([prefix[-1:], planned[: request.horizon_frames]])
        if not np.isfinite(features).all():
            raise SimulationError("the diffusion planner gave values that are not finite")
        positions = features_to_global(features, PLANNER_FPS, state)
        clip = with_planted_feet(
            positions, features[:, CONTACTS], PLANNER_FPS, hands_of(wishes.aims, row), toes_of(wishes.aims, row)
        )
        return Plan(
            planner="dip",
            weights_id=self._weights_id,
            skeleton=CANONICAL.id,
            start_tick=request.start_tick,
            positions_w_m=clip.positions_w_m,
            rotations_6d=clip.rotations_6d,
            seed=request.seed,
            ignored_conditions=wishes.ignored[row],
            guidance=guidance if request.text is not None else None,
        )


def folded(network: DipNetwork, settings: DipSettings) -> FoldedDip:
    """The network as the settings want it run."""
    chosen = choose_blocks(network, settings.runtime, settings.bf16, settings.threads)
    return FoldedDip(network, chosen.quick, chosen.exact, chosen.name)
