// Which character or episode this page shows, how it is found again after a reload, and what its stream changes.

import { call } from "./api.js";
import { Connection } from "./connection.js";
import { toast } from "./dom.js";
import { emit, update, view } from "./store.js";

const KEY = "motionloop.character";
const KEPT_EVENTS = 800;
const WINDOW_MS = 3000;
const STAND = { text: "a person is standing still." };
const NEWS_S = 5;
const FIRST = { scene: "room", seed: 1 }; // a bag to hit and a sofa to sit on

/** Finds, makes and watches characters and episodes. */
export class Session {
  constructor() {
    this.connection = null;
    this.seen = []; // [ms here, seconds at the server, tick] of the last states
  }

  /** Show what the address or the last visit names; else a character that is there; else a new one. */
  async restore() {
    const { kind, id } = named();
    if (kind === "episode") {
      const { items } = await call("GET", "/v1/episodes?status=running&limit=200");
      if (items.some((item) => item.id === id)) {
        this.watch({ kind, id });
        return;
      }
    }
    const { items } = await call("GET", "/v1/characters");
    const wanted = kind === "character" ? id : localStorage.getItem(KEY);
    const alive = items.filter((item) => item.status !== "failed");
    const found = items.find((item) => item.id === wanted) ?? alive.findLast((item) => item.pacing === "realtime");
    if (found === undefined) await this.create(FIRST);
    else this.watch({ kind: "character", id: found.id }, found);
  }

  /** Make a character that runs by the clock, and show it. */
  async create(spec) {
    const made = await call("POST", "/v1/characters", { pacing: "realtime", ...spec });
    this.watch({ kind: "character", id: made.id }, made);
  }

  /** Show something else from now on. */
  watch(watching, body = null) {
    this.connection?.close();
    this.seen = [];
    if (watching.kind === "character") localStorage.setItem(KEY, watching.id);
    history.replaceState(null, "", `#${watching.kind}=${watching.id}`);
    update("watching", {
      watching, mode: "live", link: "connecting", frame: null, liveFrame: null, plan: null, command: body?.command ?? null, task: null,
      events: [], recording: null, picked: null,
      measured: { planMs: null, errorMm: null, realtime: null, updatesPerS: null },
    });
    this.connection = new Connection(watching, {
      state: (block) => this.takeState(block),
      plan: (block) => this.takePlan(block),
      event: (event) => this.takeEvent(event),
      link: (link) => update("link", { link }),
      ended: () => this.ended(watching),
    });
    emit("command", view.command);
  }

  /** The character of this visit again, after an episode. */
  async home() {
    history.replaceState(null, "", location.pathname);
    await this.restore();
  }

  takeState({ header, arrays }) {
    const now = performance.now();
    this.measure(now, header);
    const before = view.liveFrame;
    view.updates += 1;
    view.liveFrame = {
      tick: header.tick, timeS: header.time_s, paused: header.paused, status: header.status, reason: header.reason,
      tracker: header.tracker, errorM: header.tracking_error_m, fallen: header.fallen, contacts: header.contacts,
      missedTicks: header.missed_ticks, planEndTick: header.plan_end_tick, failure: header.failure,
      objects: header.objects, positions: arrays.positions_m, rotations: arrays.rotations_wxyz,
      objectPositions: arrays.object_positions_m, objectRotations: arrays.object_rotations_wxyz,
    };
    if (before?.fallen && !header.fallen) this.takeEvent({ seq: 0, type: "stood", tick: header.tick, data: {} });
    if (view.mode === "live") update("frame", { frame: view.liveFrame });
  }

  measure(now, header) {
    this.seen.push([now, header.server_s, header.tick]);
    while (this.seen.length > 2 && now - this.seen[0][0] > WINDOW_MS) this.seen.shift();
    const [then, servedS, tick] = this.seen[0];
    const { measured } = view;
    measured.errorMm = header.tracking_error_m * 1000;
    const passedS = header.server_s - servedS;
    if (passedS > 0.7) measured.realtime = header.paused ? null : (header.tick - tick) / 30 / passedS;
    if (now - then > 700) measured.updatesPerS = (this.seen.length - 1) / ((now - then) / 1000);
    emit("measured", measured);
  }

  takePlan({ header, arrays, shapes }) {
    const [count, joints] = shapes.positions_m;
    view.plan = {
      startTick: header.start_tick, fps: header.fps, planner: header.planner, count, joints,
      positions: arrays.positions_m, rotations: arrays.rotations_wxyz,
    };
  }

  takeEvent(event) {
    const { type, data } = event;
    view.events.push(event);
    if (view.events.length > KEPT_EVENTS) view.events.splice(0, view.events.length - KEPT_EVENTS);
    const news = event.unix_s !== undefined && Date.now() / 1000 - event.unix_s < NEWS_S;
    if (type === "command") update("command", { command: data });
    else if (type === "reset" && view.watching?.kind === "character") update("command", { command: STAND });
    else if (type === "plan_refused") {
      update("command", { command: STAND });
      if (news) toast(`The planner refused the command: ${data.message}`);
    } else if (type === "task_begin") update("command", { task: data });
    else if (type === "plan") Object.assign(view.measured, { planMs: data.total_ms, planParts: data.parts_ms ?? {} });
    else if (type === "swap" && news) emit("swapped", data);
    else if (type === "failed" && news) toast(data.reason);
    emit("event", event);
  }

  async ended(watching) {
    update("link", { link: "ended" });
    if (watching.kind === "episode") emit("episode-ended", watching.id);
    else toast("This character was ended.", "info");
    localStorage.removeItem(KEY);
    await this.home();
  }
}

function named() {
  const [kind, id] = location.hash.slice(1).split("=");
  return ["character", "episode"].includes(kind) && id ? { kind, id } : { kind: null, id: null };
}
