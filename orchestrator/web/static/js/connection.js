// One WebSocket to a character or a running episode: comes back by itself, and never lets states pile up.

import { call, protocols } from "./api.js";
import { unpack } from "./blocks.js";

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 5000;
const PAST_EVENTS = 400;

/** Watches one thing until `close`. Handlers: state, plan, event, link("connecting" | "live" | "lost"), ended. */
export class Connection {
  constructor(watching, handlers) {
    this.watching = watching;
    this.handlers = handlers;
    this.lastEvent = 0;
    this.wait = FIRST_WAIT_MS;
    this.closed = false;
    this.socket = null;
    this.timer = null;
    this.wake = () => this.hurry();
    window.addEventListener("online", this.wake);
    document.addEventListener("visibilitychange", this.wake);
    this.open();
  }

  /** Watch no longer. */
  close() {
    this.closed = true;
    clearTimeout(this.timer);
    window.removeEventListener("online", this.wake);
    document.removeEventListener("visibilitychange", this.wake);
    this.socket?.close();
  }

  /** After a break, ask first whether there is still something to watch: a refused socket says no reason. */
  async open() {
    this.timer = null;
    let found;
    try {
      found = await exists(this.watching);
    } catch {
      this.later();
      return;
    }
    if (this.closed) return;
    if (!found) {
      this.close();
      this.handlers.ended();
      return;
    }
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const past = this.lastEvent > 0 ? `since=${this.lastEvent}` : `tail=${PAST_EVENTS}`;
    const path = `/v1/${this.watching.kind}s/${this.watching.id}/stream?format=binary&${past}`;
    const socket = new WebSocket(`${scheme}://${location.host}${path}`, protocols());
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.wait = FIRST_WAIT_MS;
      this.handlers.link("live");
    });
    socket.addEventListener("message", (message) => this.take(socket, message.data));
    socket.addEventListener("close", () => this.later());
    this.socket = socket;
  }

  take(socket, data) {
    if (this.closed) return;
    if (typeof data === "string") {
      const { event } = JSON.parse(data);
      this.lastEvent = event.seq;
      this.handlers.event(event);
      return;
    }
    const block = unpack(data);
    if (block.header.type === "plan") {
      this.handlers.plan(block);
      return;
    }
    // The server sends the next one only while few are unacknowledged, so a slow page sees the newest and not a queue.
    socket.send(String(block.header.tick));
    this.handlers.state(block);
  }

  later() {
    if (this.closed || this.timer !== null) return;
    this.socket = null;
    this.handlers.link("lost");
    this.timer = setTimeout(() => this.open(), this.wait * (0.75 + 0.5 * Math.random()));
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT_MS);
  }

  hurry() {
    if (this.timer === null || document.hidden) return;
    clearTimeout(this.timer);
    this.wait = FIRST_WAIT_MS;
    this.open();
  }
}

async function exists(watching) {
  if (watching.kind === "episode") {
    const { items } = await call("GET", "/v1/episodes?status=running&limit=200");
    return items.some((item) => item.id === watching.id);
  }
  const { items } = await call("GET", "/v1/characters");
  return items.some((item) => item.id === watching.id);
}
