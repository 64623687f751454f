"""Sentences for what a clip shows. `{s}` is the side as seen by the person; mirroring swaps left and right."""

from __future__ import annotations

import re
from collections.abc import Iterable

BEHAVIOURS = (
    "walk", "run", "turn", "stand", "wave", "jump", "punch", "kick", "squat", "sneak", "dance", "gesture", "get_up",
    "lie_down", "pick_up", "throw", "sit", "other",
)  # fmt: skip
"""Canonical behaviour ids of the corpus."""

SENTENCES: dict[str, tuple[str, ...]] = {
    "walk": ("a person walks forward", "walk forward", "someone is walking straight ahead", "walk", "a person walks", "a man walks at a normal pace", "the person strolls forward", "go forward", "keep walking"),
    "walk_slow": ("a person walks slowly", "walk slowly", "someone is walking at a slow pace", "a person strolls forward slowly", "walk forward slowly", "walk leisurely"),
    "walk_fast": ("a person walks quickly", "walk fast", "someone walks briskly", "a person walks forward with large quick steps", "walk quickly forward", "hurry up and walk"),
    "walk_back": ("a person walks backwards", "walk backwards", "someone is stepping backward", "go back", "move backwards"),
    "walk_side": ("a person walks sideways to the {s}", "side step to the {s}", "step to the {s}", "someone moves sideways to the {s}"),
    "walk_curve": ("a person walks in a curve to the {s}", "walk and curve to the {s}", "someone walks bending their path to the {s}", "walk to the {s}", "a person walks forward veering {s}", "turn {s} while walking"),
    "walk_circle": ("a person walks in a circle to the {s}", "walk in a circle", "someone walks around in a {s} circle", "walk in a circle to the {s}", "a person is walking round in circles turning {s}"),
    "walk_turn": ("a person walks and turns {s}", "walk forward then turn {s}", "someone walks, then makes a {s} turn", "turn to the {s} and keep walking"),
    "walk_uturn": ("a person walks, turns around over the {s} shoulder and walks back", "walk, turn around and come back", "make a u-turn to the {s}", "turn around and walk the other way", "someone turns back while walking"),
    "walk_start": ("a person stands and then starts to walk", "start walking", "someone begins to walk forward from standing", "stand, then walk forward", "a standing person walks off"),
    "walk_stop": ("a person walks and then stops", "stop walking and stand", "someone walks forward, slows down and stands still", "walk, then halt", "come to a stop"),
    "walk_start_stop": ("a person starts walking, walks a few steps and stops", "walk a few steps and stop", "someone stands, walks forward and stands again", "take a few steps forward", "walk forward a little, then stand still"),
    "run": ("a person runs forward", "run", "someone is running", "a person jogs forward", "run forward", "jog", "the person runs straight ahead", "run fast", "a man is jogging", "someone sprints forward"),
    "run_curve": ("a person runs in a curve to the {s}", "run to the {s}", "someone jogs in a curve to the {s}", "run and turn {s}", "run"),
    "run_circle": ("a person jogs in a circle to the {s}", "jog in a circle to the {s}", "someone runs around in a {s} circle", "run in a circle", "run"),
    "run_start": ("a person stands and then starts running", "start running", "someone takes off running from a stand", "stand, then run", "run", "a person runs forward", "jog", "a person is jogging"),
    "run_stop": ("a person runs and then stops", "stop running", "someone runs forward, slows down and stands", "run, then stop and stand still", "stop and stand", "stop"),
    "turn": ("a person turns {s} on the spot", "turn {s}", "someone turns to the {s}", "turn to the {s} in place", "a standing person steps around to face {s}", "rotate to the {s}", "face {s}", "a person turns in place", "turn on the spot", "turn"),
    "turn_around": ("a person turns around to the {s}", "turn around", "someone turns all the way round", "turn around on the spot", "a person turns 180 degrees to the {s}", "face the other way", "a person turns in place", "spin round on the spot"),
    "stand": ("a person stands still", "stand still", "stand", "someone is standing", "a person stays in place", "wait", "the person stands idle", "stop and stand", "stay where you are", "a man stands in place without moving"),
    "wave": ("a person waves with the {s} hand", "wave with the {s} hand", "wave", "someone waves hello with the {s} arm", "wave the {s} hand", "a person raises the {s} hand and waves", "say hello", "greet someone with a wave"),
    "wave_both": ("a person waves with both hands", "wave with both hands", "wave both arms", "someone waves both arms above the head", "a person raises both hands and waves", "wave"),
    "walk_wave": ("a person walks and waves with the {s} hand", "walk while waving the {s} hand", "someone walks forward waving", "wave with the {s} hand while walking", "wave and keep walking"),
    "jump": ("a person jumps up", "jump", "jump up", "someone jumps in place", "a person jumps on the spot", "jump into the air", "leap up", "hop up", "someone hops in place with both feet"),
    "jump_forward": ("a person jumps forward", "jump forward", "someone leaps forward with both feet", "jump", "make a jump forward"),
    "jump_side": ("a person jumps sideways to the {s}", "jump to the {s}", "someone hops to the {s}", "jump sideways", "jump"),
    "jump_turn": ("a person jumps and turns in the air", "jump and turn", "someone jumps while turning {s}", "jump", "do a turning jump to the {s}"),
    "hop": ("a person hops forward with both legs", "hop", "hop forward", "someone hops once on both feet", "jump"),
    "hop_one": ("a person hops on one leg", "hop on one foot", "jump on one leg", "someone jumps on a single foot"),
    "punch": ("a person punches", "punch", "someone throws punches", "a person punches repeatedly", "box", "strike with the fist"),
    "punch_step": ("a person steps forward and punches", "punch", "someone lunges forward with a punch", "do a lunge punch", "a person does karate punches"),
    "karate": ("a person performs a karate kata", "do karate", "someone performs martial arts moves", "a person does karate", "perform a kata", "fight with martial arts"),
    "kick": ("a person kicks with the {s} leg", "kick", "kick with the {s} foot", "someone kicks forward with the {s} leg", "a person does a front kick with the {s} leg", "{s} kick"),
    "kick_any": ("a person does a kick", "kick", "someone kicks high", "a person kicks", "do a martial arts kick"),
    "kick_round": ("a person does round kicks", "round kick", "kick", "someone does roundhouse kicks on both sides", "do a roundhouse kick"),
    "kick_front": ("a person does front kicks", "front kick", "kick", "someone does karate front kicks", "kick forward"),
    "kick_spin": ("a person does a spin kick", "spin kick", "kick", "someone spins and kicks", "do a spinning kick"),
    "kick_ball": ("a person kicks a ball", "kick the ball", "someone runs up and kicks a soccer ball", "kick", "a person plays soccer"),
    "box": ("a person boxes", "box", "someone is boxing", "shadow box", "a person throws punches like a boxer", "punch"),
    "drink": ("a person drinks from a bottle", "drink", "someone takes a drink", "have a drink", "raise a bottle and drink"),
    "laugh": ("a person laughs", "laugh", "someone is laughing", "laugh out loud", "a person bends over with laughter"),
    "reach_up": ("a person reaches up and jumps to grab something", "reach up and jump", "someone jumps up to grab something high", "stand on tiptoe and reach up"),
    "exercise": ("a person does jumping jacks and other exercises", "do exercises", "someone exercises", "warm up", "a person does gymnastics"),
    "sit_any": ("a person sits down on a stool and stands up again", "sit down on a stool", "someone sits on a stool", "sit down and get up again", "have a seat"),
    "squat": ("a person squats", "squat", "squat down", "someone does a squat", "a person squats down and stands up again", "bend your knees and squat", "do a squat"),
    "sneak": ("a person sneaks forward", "sneak", "someone is sneaking", "a person tiptoes stealthily", "walk stealthily", "creep forward", "move quietly with bent knees"),
    "zombie": ("a person walks like a zombie", "walk like a zombie", "someone shambles forward with arms raised", "zombie walk"),
    "crawl": ("a person crawls on hands and knees", "crawl", "someone is crawling forward", "crawl on the floor"),
    "roll": ("a person rolls forward on the floor", "roll", "someone does a forward roll", "do a somersault"),
    "cartwheel": ("a person does a cartwheel", "cartwheel", "someone does a cartwheel"),
    "flip": ("a person does a flip", "flip", "someone does a somersault in the air", "do a flip"),
    "spin": ("a person spins around", "spin", "someone spins on the spot", "spin around"),
    "dance": ("a person dances", "dance", "someone is dancing", "a person does a dance", "dance around"),
    "dance_salsa": ("a person dances salsa", "dance salsa", "someone dances salsa steps", "dance", "a person is dancing with a partner"),
    "dance_indian": ("a person performs an indian dance", "dance an indian dance", "someone performs a traditional dance", "dance"),
    "dance_ballet": ("a person dances ballet", "dance ballet", "someone does expressive ballet moves", "dance", "a dancer turns and poses gracefully"),
    "gesture_traffic": ("a person directs traffic", "direct the traffic", "someone gestures with both arms like a policeman", "a person signals with the arms"),
    "gesture_signals": ("a person makes basketball signals with the arms", "make referee signals", "someone stands and gestures with both arms", "a person signals with the hands", "gesture"),
    "gesture_arms": ("a person rotates both arms backward", "swing your arms in circles", "someone circles both arms", "rotate the arms", "arm circles"),
    "gesture_wash": ("a person washes a window", "wash the window", "someone wipes a window with the hand", "wipe in front of you"),
    "gesture_wash_self": ("a person washes themselves", "wash yourself", "someone takes a shower", "rub your body as in a shower"),
    "gesture": ("a person gestures with the arms", "gesture", "someone moves their arms while standing", "make a gesture"),
    "celebrate": ("a person celebrates", "celebrate a goal", "someone poses in celebration", "strike a pose"),
    "elbow_knee": ("a person touches the knee with the elbow", "elbow to knee", "someone lifts a knee to the opposite elbow", "bring the elbow to the knee", "do a standing crunch"),
    "pick_up": ("a person bends down and picks something up", "pick something up", "someone reaches to the floor", "bend down and reach the floor", "a person picks up an object from the floor"),
    "deposit": ("a person puts something on the floor with the {s} hand", "put it down on the floor", "someone bends and places an object on the floor", "bend down and reach the floor", "put something down"),
    "grab_high": ("a person reaches up high with the {s} hand", "reach up high", "someone grabs something from a high shelf", "grab high with the {s} hand", "reach for something above you"),
    "throw": ("a person throws a ball", "throw", "someone throws a basketball", "throw the ball", "toss a ball forward"),
    "dribble": ("a person dribbles a basketball", "dribble a ball", "someone plays basketball", "a person dribbles a ball while walking"),
    "sword": ("a person swings a sword", "swing a sword", "someone practises swordplay", "fight with a sword"),
    "lie_down": ("a person lies down on the floor", "lie down", "someone lies down", "go to the floor and lie down", "lie on the ground"),
    "get_up": ("a person gets up from the floor", "get up", "someone stands up from lying", "stand up from the ground", "rise from the floor"),
    "balance": ("a person balances on one leg", "balance on one foot", "someone stands on one leg", "stand on one leg", "lift one foot and balance"),
    "lunge": ("a person steps forward and back", "step forward and step back", "someone takes a step forward and returns", "do a lunge"),
    "steps": ("a person takes a few steps forward", "take a step forward", "someone steps forward", "step forward"),
    "stretch": ("a person stretches", "stretch", "someone does a sports pose", "strike a pose"),
}  # fmt: skip


def sentences(action: str, side: str = "") -> list[str]:
    """Sentences of an action with its side filled in; those that need a side are left out where there is none."""
    out = [s.replace("{s}", side) for s in SENTENCES[action] if side or "{s}" not in s]
    return out


def swap_sides(text: str) -> str:
    """The sentence with left and right (and the turning senses) exchanged."""
    swap = {"left": "right", "right": "left", "clockwise": "counterclockwise", "counterclockwise": "clockwise"}

    def other(match: re.Match[str]) -> str:
        word = match.group(0)
        new = swap[word.lower()]
        return new.capitalize() if word[0].isupper() else new

    return re.sub(r"\b(left|right|counterclockwise|clockwise)\b", other, text, flags=re.IGNORECASE)


def clean(texts: Iterable[str]) -> list[str]:
    """Lower-case sentences without a full stop, each once, in order."""
    out: list[str] = []
    for text in texts:
        words = " ".join(text.strip().rstrip(".").lower().split())
        if words and words not in out:
            out.append(words)
    return out
