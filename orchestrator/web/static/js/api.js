// Requests to the server that the page came from, and to no other.

import { unpack } from "./blocks.js";
import { byId } from "./dom.js";

const TOKEN_KEY = "motionloop.token";

/** An error that the server explained: its message names the field and what is allowed. */
export class Problem extends Error {
  constructor(status, body) {
    const allowed = body.allowed ? ` (allowed: ${body.allowed})` : "";
    super(`${body.detail ?? body.title ?? `HTTP ${status}`}${allowed}`);
    this.status = status;
    this.field = body.field ?? null;
  }
}

/** The bearer token of this visit, or null. */
export function token() {
  return sessionStorage.getItem(TOKEN_KEY);
}

async function request(method, path, body) {
  for (;;) {
    const headers = {};
    if (body !== undefined) headers["Content-Type"] = "application/json";
    if (token() !== null) headers.Authorization = `Bearer ${token()}`;
    let response;
    try {
      response = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
    } catch {
      throw new Problem(0, { detail: "the server does not answer" });
    }
    if (response.status === 401) {
      await askForToken();
      continue;
    }
    if (!response.ok) throw new Problem(response.status, await response.json().catch(() => ({})));
    return response;
  }
}

/** JSON from the server; throws Problem. */
export async function call(method, path, body) {
  const response = await request(method, path, body);
  return response.status === 204 ? null : response.json();
}

/** A block of numbers (see blocks.js). */
export async function getBlock(path) {
  return unpack(await (await request("GET", path)).arrayBuffer());
}

/** Save what is at `path` as a file. */
export async function download(path, filename) {
  const response = await request("GET", path);
  const url = URL.createObjectURL(await response.blob());
  const link = document.createElement("a");
  link.href = url;
  link.download = filename;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

/** WebSocket subprotocols: a browser cannot set headers on a socket, so the token travels here. */
export function protocols() {
  if (token() === null) return ["motionloop"];
  const bytes = Array.from(new TextEncoder().encode(token()), (byte) => String.fromCharCode(byte)).join("");
  const text = btoa(bytes).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return ["motionloop", `bearer.${text}`];
}

let asking = null;

function askForToken() {
  asking ??= new Promise((resolve) => {
    const dialog = byId("token");
    dialog.addEventListener(
      "close",
      () => {
        sessionStorage.setItem(TOKEN_KEY, byId("token-value").value);
        asking = null;
        resolve();
      },
      { once: true },
    );
    dialog.showModal();
  });
  return asking;
}
