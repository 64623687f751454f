// Buttons for the tasks there are, and the episode that is put together from them.

import { titleOf } from "./agenda.js";
import { call } from "./api.js";
import { attempt, byId, el, icon } from "./dom.js";
import { view } from "./store.js";

const WHAT = {
  reach: "To a place ahead of it, or anywhere", halt: "Stop, and stay there", text: "Anything you can put in words",
  strike: "Topple the bag of a scene that has one", sit: "On the seat of a scene that has one",
  get_up: "From the seat, or from the floor", velocity: "So fast, in one direction",
};
/** Fields worth showing, in this order, where a task has them; the rest keep the server's defaults. */
const SHOWN = ["text", "limb", "hand", "joint", "gait", "style", "from", "relative_m", "relative_mps", "retries", "duration_s", "time_limit_s"];
const WORDS = {
  text: "In words", relative_m: ["Ahead, m", "To the left, m"], relative_mps: ["Ahead, m/s", "To the left, m/s"], duration_s: "For, s", time_limit_s: "Time limit, s",
};
const FIRST = { text: "a person waves with the right hand." };

/** Wire the panel; `session` shows the episode that is started. */
export async function setUpTasks(session) {
  const { items } = await call("GET", "/v1/tasks");
  const plan = []; // { kind, values }

  async function run(tasks, spec = {}) {
    const made = await call("POST", "/v1/episodes", { pacing: "realtime", seed: 1, ...spec, tasks });
    session.watch({ kind: "episode", id: made.id });
  }

  function add(kind) {
    plan.push({ kind, values: defaults(kind) });
    render();
  }

  function render() {
    byId("plan-list").replaceChildren(...plan.map((task, i) => row(task, i)));
    byId("plan-empty").hidden = plan.length > 0;
    byId("episode").querySelector("[type=submit]").disabled = plan.length === 0;
  }

  function move(i, by) {
    const [task] = plan.splice(i, 1);
    plan.splice(i + by, 0, task);
    render();
    byId("plan-list").children[i + by].querySelector(by < 0 ? "[data-up]" : "[data-down]").focus();
  }

  function row(task, i) {
    const button = (name, label, disabled, data, act) =>
      el("button", { type: "button", class: "icon-button", "aria-label": label, disabled, dataset: data, onclick: act },
        icon(name));
    const title = titleOf(task.kind.type);
    return el("li", {},
      el("div", { class: "head" }, el("b", {}, title),
        button("up", `Move ${title} up`, i === 0, { up: "" }, () => move(i, -1)),
        button("down", `Move ${title} down`, i === plan.length - 1, { down: "" }, () => move(i, 1)),
        button("close", `Remove ${title}`, false, {}, () => {
          plan.splice(i, 1);
          render();
        })),
      fields(task));
  }

  byId("kinds").replaceChildren(
    ...items.map((kind) =>
      el("div", { class: "kind" },
        el("div", {}, el("b", {}, titleOf(kind.type)), el("p", {}, WHAT[kind.type] ?? firstSentence(kind.description))),
        el("button", { type: "button", class: "quiet", onclick: () => add(kind),
          "aria-label": `Add ${titleOf(kind.type)}` }, "Add"),
        el("button", { type: "button", class: "primary",
          "aria-label": `Run ${titleOf(kind.type)} now`,
          onclick: () => attempt(() => run([body({ kind, values: defaults(kind) })], scene())) }, "Run")),
    ),
  );
  byId("episode").addEventListener("submit", (event) => {
    event.preventDefault();
    const { pacing, seed } = byId("episode").elements;
    const spec = { pacing: pacing.value, seed: Number(seed.value), ...scene() };
    attempt(() => run(plan.map(body), spec));
  });
  render();
}

function scene() {
  const { value } = byId("episode-scene");
  return value === "" ? {} : { scene: value };
}

function firstSentence(text) {
  return text.split(/[.:;](\s|$)/u)[0];
}

/** What a field of a JSON Schema is: text, number, pair, choice, or null for what is not offered here. */
function shapeOf(schema) {
  const branch = schema.anyOf?.find((option) => option.type !== "null") ?? schema;
  if (Array.isArray(branch.enum)) {
    return { shape: "choice", choices: branch === schema ? branch.enum : ["", ...branch.enum] };
  }
  if (branch.type === "string") return { shape: "text" };
  if (branch.type === "number" || branch.type === "integer") return { shape: "number" };
  if (branch.type === "array" && branch.prefixItems?.length === 2) return { shape: "pair" };
  return null;
}

function offered(kind) {
  const properties = kind.parameters.properties ?? {};
  return SHOWN.filter((name) => name in properties && shapeOf(properties[name]) !== null);
}

function defaults(kind) {
  const values = {};
  for (const name of offered(kind)) values[name] = kind.parameters.properties[name].default ?? null;
  if (kind.type === "reach") values.relative_m = targetAhead() ?? [2, 0];
  if (kind.type === "velocity") values.relative_mps = [1, 0];
  if (kind.type === "text") values.text = lastText() ?? FIRST.text;
  return values;
}

/** A fresh character starts at the origin facing +X, so the marker's place in the world is where it should go. */
function targetAhead() {
  const target = view.command?.target;
  return target?.joint === "traj" ? target.position_m.slice(0, 2) : null;
}

function lastText() {
  return view.command?.target ? null : (view.command?.text ?? null);
}

function body({ kind, values }) {
  const set = Object.entries(values).filter(([, value]) => value !== null && value !== "");
  return { type: kind.type, ...Object.fromEntries(set) };
}

function fields(task) {
  const inputs = offered(task.kind).flatMap((name) => {
    const schema = task.kind.parameters.properties[name];
    const { shape, choices } = shapeOf(schema);
    const words = WORDS[name] ?? name.replaceAll("_", " ");
    const value = task.values[name];
    if (shape === "choice") {
      const select = el("select", { onchange: () => { task.values[name] = select.value || null; } },
        ...choices.map((choice) => el("option", { value: String(choice) }, String(choice))));
      select.value = value ?? choices[0];
      return [el("label", {}, words, select)];
    }
    if (shape === "text") {
      const input = el("input", { type: "text", value: value ?? "", maxlength: "300", oninput: () => {
        task.values[name] = input.value.trim() || null;
      } });
      return [el("label", { class: "full" }, words, input)];
    }
    if (shape === "number") {
      const input = el("input", { type: "number", step: "any", value: String(value ?? ""), oninput: () => {
        task.values[name] = input.value === "" ? null : Number(input.value);
      } });
      return [el("label", {}, words, input)];
    }
    const names = Array.isArray(words) ? words : [`${words}, first`, `${words}, second`];
    const pair = names.map((_, i) =>
      el("input", { type: "number", step: "any", value: String(value?.[i] ?? ""), oninput: () => {
        const both = pair.map((input) => input.value);
        task.values[name] = both.some((text) => text === "") ? null : both.map(Number);
      } }));
    return pair.map((input, i) => el("label", {}, names[i], input));
  });
  return el("div", { class: "fields" }, ...inputs);
}
