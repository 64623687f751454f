// Playing a recorded episode in the view, with a scrubber.

import { getBlock } from "./api.js";
import { byId, clock, el, icon, press, setText } from "./dom.js";
import { blend, emptyPose, frameOf } from "./pose.js";
import { update, view } from "./store.js";

/** A recording and where it is played; `place` counts frames and may lie between two. */
export class Replay {
  constructor() {
    this.id = null;
    this.motion = null;
    this.place = 0;
    this.playing = false;
    this.pose = null;
    this.slider = byId("scrub");
    byId("play").addEventListener("click", () => this.toggle());
    byId("leave").addEventListener("click", () => this.close());
    this.slider.addEventListener("input", () => {
      this.playing = false;
      this.seek(Number(this.slider.value));
    });
  }

  /** Fetch an episode's recording and play it from the beginning. */
  async open(id, title) {
    const { header, arrays, shapes } = await getBlock(`/v1/episodes/${id}/frames`);
    const joints = shapes.positions_m[1];
    this.id = id;
    this.motion = {
      joints, count: header.count, fps: header.fps, startTick: header.start_tick, objects: header.objects,
      positions: arrays.positions_m, rotations: arrays.rotations_wxyz, errorM: arrays.tracking_error_m,
      fallen: arrays.fallen, poses: arrays.object_poses, results: header.results,
    };
    this.pose = emptyPose(joints);
    this.slider.max = String(header.count - 1);
    setText(byId("replay-name"), title);
    byId("replay-marks").replaceChildren(...header.results.map((result) => this.mark(result)));
    byId("player").hidden = false;
    byId("command").hidden = true;
    update("mode", { mode: "replay" });
    update("picked", { picked: null });
    this.playing = true;
    this.seek(0);
    byId("play").focus();
  }

  /** Back to what is live. */
  close() {
    this.id = null;
    this.motion = null;
    byId("player").hidden = true;
    byId("command").hidden = false;
    update("mode", { mode: "live", frame: view.liveFrame });
  }

  toggle() {
    if (!this.playing && this.place >= this.motion.count - 1) this.place = 0;
    this.playing = !this.playing;
    this.showButton();
  }

  /** Go on by some seconds and return the pose to draw. */
  at(seconds) {
    if (this.playing) {
      const last = this.motion.count - 1;
      this.place = Math.min(this.place + seconds * this.motion.fps, last);
      if (this.place >= last) this.playing = false;
      this.show();
    }
    const i = Math.floor(this.place);
    const j = Math.min(i + 1, this.motion.count - 1);
    blend(frameOf(this.motion, i), frameOf(this.motion, j), this.place - i, this.pose);
    return this.pose;
  }

  seek(place) {
    this.place = Math.min(Math.max(place, 0), this.motion.count - 1);
    this.show();
  }

  show() {
    const i = Math.round(this.place);
    const { motion } = this;
    if (this.slider.value !== String(i)) this.slider.value = String(i);
    this.slider.setAttribute("aria-valuetext", clock(i / motion.fps));
    setText(byId("replay-time"), `${clock(i / motion.fps)} / ${clock((motion.count - 1) / motion.fps)}`);
    this.showButton();
    const objects = motion.objects.length;
    const poses = motion.poses.subarray(7 * objects * i, 7 * objects * (i + 1));
    const frame = {
      tick: motion.startTick + i, paused: !this.playing, status: "replay", reason: null, fallen: motion.fallen[i] > 0,
      errorM: motion.errorM[i], objects: motion.objects, ...frameOf(motion, i), objectPoses: poses,
    };
    update("frame", { frame });
  }

  showButton() {
    const button = byId("play");
    if (button.getAttribute("aria-pressed") === String(this.playing)) return;
    press(button, this.playing);
    button.querySelector("svg").replaceWith(icon(this.playing ? "pause" : "play"));
    setText(button.querySelector("span"), this.playing ? "Stop" : "Play");
  }

  mark(result) {
    const share = (tick) => `${(100 * (tick - this.motion.startTick)) / Math.max(this.motion.count - 1, 1)}%`;
    const mark = el("i", { dataset: { ok: String(result.success_strict) }, title: result.label });
    mark.style.left = share(result.start_tick);
    mark.style.width = `calc(${share(result.stop_tick)} - ${share(result.start_tick)})`;
    return mark;
  }
}
