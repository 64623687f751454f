// Pause, step, reset, camera, plan, record; their keys.

import { call } from "./api.js";
import { attempt, byId, icon, press } from "./dom.js";
import { on, update, view } from "./store.js";

const PUSH_NS = 40;

/** Wire the buttons. `world` and `ghost` are what the view's own switches change. */
export function setUpToolbar(world, ghost) {
  const buttons = Object.fromEntries(
    ["pause", "step", "reset", "follow", "ghost", "record"].map((id) => [id, byId(id)]),
  );
  const path = (what) => `/v1/characters/${view.watching.id}/${what}`;
  const actions = {
    pause: () => call("POST", path(view.frame?.paused ? "resume" : "pause")),
    step: () => call("POST", path("steps"), { ticks: 3 }),
    reset: () => call("POST", path("reset")),
    follow: () => {
      world.following = !world.following;
      press(buttons.follow, world.following);
    },
    ghost: () => {
      ghost.on = !ghost.on;
      press(buttons.ghost, ghost.on);
    },
    record: () => {
      const running = view.recording !== null && view.recording.stopTick === null;
      const tick = view.frame?.tick ?? 0;
      const recording = running ? { ...view.recording, stopTick: tick } : { startTick: tick, stopTick: null };
      update("recording", { recording });
    },
  };
  for (const [name, button] of Object.entries(buttons)) {
    button.addEventListener("click", () => attempt(async () => actions[name]()));
  }

  function refresh() {
    const commanded = view.watching?.kind === "character" && view.mode === "live" && view.frame !== null;
    const paused = view.frame?.paused === true;
    buttons.pause.disabled = buttons.reset.disabled = buttons.record.disabled = !commanded;
    buttons.step.disabled = !commanded || !paused;
    if (buttons.pause.getAttribute("aria-pressed") !== String(paused)) {
      press(buttons.pause, paused);
      buttons.pause.querySelector("svg").replaceWith(icon(paused ? "play" : "pause"));
      buttons.pause.querySelector("span").textContent = paused ? "Resume" : "Pause";
    }
    const recording = view.recording !== null && view.recording.stopTick === null;
    press(buttons.record, recording);
    const length = recording ? ((view.frame?.tick ?? 0) - view.recording.startTick) / 30 : 0;
    const words = recording ? `${length.toFixed(0)} s` : "Record";
    const label = buttons.record.querySelector("span");
    if (label.textContent !== words) label.textContent = words;
  }
  for (const topic of ["frame", "watching", "recording", "mode"]) on(topic, refresh);
  refresh();

  const keys = { " ": "pause", ".": "step", r: "reset", f: "follow", g: "ghost", c: "record" };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const typing = event.target instanceof Element && event.target.closest("input, select, textarea, dialog");
    if (typing) return;
    if (event.key === "/") {
      event.preventDefault();
      byId("say").focus();
      return;
    }
    const onButton = event.target instanceof Element && event.target.closest("button, summary, a");
    const name = keys[event.key.toLowerCase()];
    if (name === undefined || (onButton && event.key === " ") || buttons[name].disabled) return;
    event.preventDefault();
    buttons[name].click();
  });
}

/** Keys of the view itself: arrows turn, plus and minus zoom, shift and arrows push the chest. */
export function setUpViewKeys(world, push) {
  const turns = { ArrowLeft: [-0.12, 0], ArrowRight: [0.12, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] };
  const pushes = { ArrowLeft: [0, 1], ArrowRight: [0, -1], ArrowUp: [1, 0], ArrowDown: [-1, 0] };
  world.canvas.addEventListener("keydown", (event) => {
    if (event.shiftKey && event.key in pushes) {
      const [ahead, left] = pushes[event.key];
      const away = world.camera.position.clone().sub(world.controls.target);
      const angle = Math.atan2(-away.y, -away.x);
      const x = Math.cos(angle) * ahead - Math.sin(angle) * left;
      const y = Math.sin(angle) * ahead + Math.cos(angle) * left;
      push("spine3", [PUSH_NS * x, PUSH_NS * y, 0]);
    } else if (event.key in turns) world.nudge(...turns[event.key], 1);
    else if (event.key === "+" || event.key === "=") world.nudge(0, 0, 0.88);
    else if (event.key === "-") world.nudge(0, 0, 1.14);
    else return;
    event.preventDefault();
  });
}
