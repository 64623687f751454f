"""The takes in a mocap folder: which files there are, what each is, and how to read it."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass
from pathlib import Path

from shared.motion.io.asfamc import read_asf_amc
from shared.motion.io.bvh import read_bvh
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import RawMotion
from shared.motion.io.smpl import read_smpl_npz
from shared.protocol.rates import CORPUS_FPS as FPS


@dataclass(frozen=True)
class Take:
    """One recording.

    Attributes:
        name: `<source>/<file stem>`, unique; the split hashes it.
        source: folder it comes from.
        path: motion file; asf: its skeleton, for AMC.
        skeleton_key: takes with the same key share a calibration.
        behaviour: canonical behaviour id of the take as a whole.
        action: key into texts.SENTENCES; `auto` where the kinematics decide; side: left, right or ''.
        texts: sentences known for this very take.
        skip: why it is left out, or ''.
        options: how to read it, for takes of no known collection; by_motion: nothing says what it is.
    """

    name: str
    source: str
    path: Path
    asf: Path | None
    skeleton_key: str
    behaviour: str
    action: str
    side: str = ""
    texts: tuple[str, ...] = ()
    skip: str = ""
    options: ReadOptions | None = None
    by_motion: bool = False

    def read(self) -> RawMotion:
        """The motion as recorded."""
        if self.options is not None:
            return read_motion(self.path, self.options)
        if self.asf is not None:
            return read_asf_amc(self.asf, self.path, FPS, up="y")
        if self.path.suffix == ".npz":
            return read_smpl_npz(self.path, up="z")
        return read_bvh(self.path, up="y")


# Pattern on the file stem -> (behaviour, action, side). The first that matches wins.
_RULES: dict[str, tuple[tuple[str, tuple[str, str, str]], ...]] = {
    "hdm05": (
        ("depositFloorR", ("pick_up", "deposit", "right")),
        ("elbowToKnee", ("gesture", "elbow_knee", "")),
        ("grabHighR", ("gesture", "grab_high", "right")),
        ("hopBothLegs", ("jump", "hop", "")),
        ("jogLeftCircle", ("run", "run_circle", "left")),
        ("kickLFront", ("kick", "kick", "left")),
        ("lieDownFloor", ("lie_down", "lie_down", "")),
        ("rotateArms", ("gesture", "gesture_arms", "")),
        ("sneak", ("sneak", "sneak", "")),
        ("squat", ("squat", "squat", "")),
        ("throwBasketball", ("throw", "throw", "")),
    ),
    "asap_smpl": (
        ("single_foot_balance", ("other", "balance", "")),
        ("single_foot_jump", ("jump", "hop_one", "")),
        ("side_jump", ("jump", "jump_side", "auto")),
        ("jump_forward", ("jump", "jump_forward", "")),
        ("jump_degree_level1", ("jump", "jump", "")),
        ("jump_degree", ("jump", "jump_turn", "auto")),
        ("CR7", ("jump", "jump_turn", "auto")),
        ("squat", ("squat", "squat", "")),
        ("step_forward", ("walk", "steps", "")),
        ("walk", ("walk", "walk_start_stop", "")),
        ("kick", ("kick", "kick_any", "")),
        ("shoot", ("kick", "kick_ball", "")),
        ("SpiderMan", ("other", "stretch", "")),
        ("Kobe", ("throw", "throw", "")),
        ("lebron|Bolt|TigerWoods|APT", ("gesture", "celebrate", "")),
    ),
    "cmu_actions": (
        ("basketball_signal", ("gesture", "gesture_signals", "")),
        ("basketball", ("other", "dribble", "")),
        ("directing_traffic", ("gesture", "gesture_traffic", "")),
        ("jumping", ("jump", "auto", "")),
        ("running", ("run", "auto", "")),
        ("soccer", ("kick", "kick_ball", "")),
        ("walking", ("walk", "auto", "")),
        ("washwindow", ("gesture", "gesture_wash", "")),
    ),
    "deepmimic": (
        ("backflip|sideflip", ("other", "flip", "")),
        ("cartwheel", ("other", "cartwheel", "")),
        ("crawl", ("other", "crawl", "")),
        ("dance", ("dance", "dance", "")),
        ("getup", ("get_up", "get_up", "")),
        ("jog|run", ("run", "auto", "")),
        ("jump", ("jump", "jump_forward", "")),
        ("spinkick", ("kick", "kick_spin", "")),
        ("kick", ("kick", "kick_any", "")),
        ("zombie", ("walk", "zombie", "")),
        ("stealthy", ("sneak", "sneak", "")),
        ("walk", ("walk", "auto", "")),
        ("punch", ("punch", "punch", "")),
        ("roll", ("other", "roll", "")),
        ("spin", ("dance", "spin", "")),
    ),
    "cmu_martial": (
        ("04", ("kick", "kick_front", "")),
        ("07", ("kick", "kick_round", "")),
        ("08", ("other", "karate", "")),
        ("09", ("punch", "punch_step", "")),
        ("", ("punch", "karate", "")),
    ),
    "cmu_salsa": (("", ("dance", "dance_salsa", "")),),
    "cmu_indian": (("", ("dance", "dance_indian", "")),),
    "cmu_start_stop": (("", ("dance", "dance", "")),),
}

# CMU trials whose file name is subject_trial: by the description in cmu_index.csv.
_CMU_RULES: tuple[tuple[str, tuple[str, str, str]], ...] = (
    ("sit on", ("sit", "sit_any", "")),
    ("boxing", ("punch", "box", "")),
    ("soccer", ("kick", "kick_ball", "")),
    ("direct traffic", ("gesture", "gesture_traffic", "")),
    ("wash windows", ("gesture", "gesture_wash", "")),
    ("drink", ("gesture", "drink", "")),
    ("laugh", ("gesture", "laugh", "")),
    ("grab, reach", ("jump", "reach_up", "")),
    ("jumping jacks", ("gesture", "exercise", "")),
    ("forward jump", ("jump", "jump_forward", "")),
    ("navigate", ("walk", "auto", "")),
    ("playground", ("other", "skip", "")),
    ("uneven", ("walk", "skip", "")),
    ("run", ("run", "auto", "")),
    ("dribble|basketball", ("other", "dribble", "")),
    ("dance", ("dance", "dance_ballet", "")),
    ("jump", ("jump", "auto", "")),
    ("punch", ("punch", "punch", "")),
    ("bend over", ("pick_up", "pick_up", "")),
    ("swordplay", ("other", "sword", "")),
    ("wash self", ("gesture", "gesture_wash_self", "")),
    ("walk", ("walk", "auto", "")),
)


def _match(rules: tuple[tuple[str, tuple[str, str, str]], ...], text: str) -> tuple[str, str, str]:
    return next((label for pattern, label in rules if re.search(pattern, text)), ("other", "auto", ""))


def _cmu_texts(folder: Path) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Description and KIT-ML sentences by trial id such as `02_05`; empty where the files are absent."""
    index: dict[str, str] = {}
    sentences: dict[str, list[str]] = {}
    if (folder / "cmu_index.csv").exists():
        with (folder / "cmu_index.csv").open(newline="", encoding="utf-8") as file:
            for row in list(csv.reader(file))[1:]:
                if len(row) >= 3 and row[0].isdigit() and row[1].isdigit():
                    index[f"{int(row[0]):02d}_{int(row[1]):02d}"] = row[2]
    if (folder / "kitml_cmu.json").exists():
        for entry in json.loads((folder / "kitml_cmu.json").read_text(encoding="utf-8")).values():
            trial = entry["path"].split("/")[-1].removesuffix("_poses")
            sentences.setdefault(trial, []).extend(a["text"] for a in entry["annotations"])
    return index, sentences


_BY_TRIAL = ("cmu_subjects", "cmu_asfamc", "cmu_daily")


def is_known(folder: Path, path: Path) -> bool:
    """Whether a file is of a collection described here."""
    source = path.relative_to(folder).parts[0]
    if path.suffix == ".amc" and source not in ("hdm05", "cmu_asfamc"):
        return False
    return source in _RULES or (source in _BY_TRIAL and re.fullmatch(r"\d+_\d+", path.stem) is not None)


def list_takes(folder: Path, texts_of: Path | None = None) -> list[Take]:
    """All takes of the known collections below an unpacked mocap folder, in a stable order.

    `texts_of`: the folder with what is said of them, else `text` below it.
    """
    index, kit = _cmu_texts(texts_of or folder / "text")
    takes = []
    for path in sorted(folder.rglob("*")):
        if path.suffix not in (".bvh", ".amc", ".npz") or not is_known(folder, path):
            continue
        source = path.relative_to(folder).parts[0]
        stem = path.stem
        asf = None
        # Some of these files have a head turned round in their zero pose and some do not: each is calibrated alone.
        key = f"{source}/{stem}" if source in ("cmu_salsa", "cmu_indian", "cmu_martial") else source
        if source == "cmu_daily":
            key = f"{source}/{stem.split('_')[0]}"
        if path.suffix == ".amc":
            prefix = stem[:6] if source == "hdm05" else stem.split("_")[0]
            asf = path.parent / f"{prefix}.asf"
            key = f"{source}/{prefix}"
        texts: list[str] = []
        if source in _BY_TRIAL:
            subject, trial = stem.split("_")
            trial_id = f"{int(subject):02d}_{trial}"
            behaviour, action, side = _match(_CMU_RULES, index.get(trial_id, ""))
            texts = kit.get(trial_id, []) + [index[trial_id]] if trial_id in index else kit.get(trial_id, [])
            texts = [t.replace(" - ", ", ") for t in texts]
        else:
            behaviour, action, side = _match(_RULES.get(source, ()), stem)
            if source == "cmu_martial":
                texts = kit.get(f"135_{stem}", [])
            elif source == "cmu_start_stop":
                texts = kit.get(stem, [])
        skip = ""
        if action == "skip":
            skip = "needs a playground that is not there" if behaviour == "other" else "walks on uneven ground"
        if source == "cmu_subjects" and stem.startswith("001"):
            skip = "needs a playground that is not there"
        takes.append(Take(f"{source}/{stem}", source, path, asf, key, behaviour, action, side, tuple(texts), skip))
    return takes
