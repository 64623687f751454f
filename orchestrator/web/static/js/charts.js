// Small live charts: how long plans take, how far the body is from the plan, how fast the clock runs.

import { byId, el, setText } from "./dom.js";
import { fitted, palette } from "./paint.js";
import { on, view } from "./store.js";

const SAMPLES = 150;
const EVERY_MS = 200;

const CHARTS = [
  { key: "planMs", name: "Plan latency", unit: "ms", digits: 0, least: 100 },
  { key: "errorMm", name: "Tracking error", unit: "mm", digits: 0, least: 60 },
  { key: "realtime", name: "Real-time factor", unit: "x", digits: 2, least: 1.25 },
];

/** Wire the charts. */
export function setUpCharts() {
  const charts = CHARTS.map((chart) => {
    const value = el("p", { class: "value" }, "-");
    const canvas = el("canvas", { role: "img", "aria-label": `${chart.name} over the last half minute` });
    byId("charts").append(
      el("div", { class: "chart" }, el("div", {}, el("p", { class: "name" }, chart.name), value), canvas),
    );
    return { ...chart, value, canvas, samples: [] };
  });
  let sampled = 0;
  on("measured", (measured) => {
    const now = performance.now();
    if (now - sampled < EVERY_MS || view.mode === "replay") return;
    sampled = now;
    for (const chart of charts) {
      const sample = measured[chart.key];
      if (sample !== null) {
        chart.samples.push(sample);
        if (chart.samples.length > SAMPLES) chart.samples.shift();
      }
      if (chart.canvas.offsetParent === null) continue;
      show(chart, sample);
    }
  });
  on("watching", () => {
    for (const chart of charts) chart.samples.length = 0;
  });
}

/** What the planner says of its share, e.g. "queue 0 ms, text 1 ms, diffusion 61 ms". */
function partsWords(parts) {
  return Object.entries(parts)
    .filter(([name]) => name !== "batch")
    .map(([name, ms]) => `${name} ${ms.toFixed(0)} ms`)
    .join(", ");
}

function show(chart, sample) {
  if (sample === null) {
    setText(chart.value, "-");
  } else {
    const words = sample.toFixed(chart.digits);
    if (chart.value.firstChild?.textContent !== words) {
      chart.value.replaceChildren(words, " ", el("small", {}, chart.unit));
      if (chart.key === "planMs") chart.value.title = partsWords(view.measured.planParts ?? {});
    }
  }
  const { context: g, width, height } = fitted(chart.canvas);
  const colours = palette();
  const top = Math.max(chart.least, ...chart.samples) * 1.08;
  const x = (i) => width - (chart.samples.length - 1 - i) * (width / (SAMPLES - 1));
  const y = (value) => height - 2 - (Math.max(value, 0) / top) * (height - 6);
  g.clearRect(0, 0, width, height);
  g.strokeStyle = colours.line;
  g.lineWidth = 1;
  g.strokeRect(0, height - 1, width, 0.001);
  if (chart.samples.length < 2) return;
  g.beginPath();
  chart.samples.forEach((value, i) => (i === 0 ? g.moveTo(x(i), y(value)) : g.lineTo(x(i), y(value))));
  g.strokeStyle = colours.accent;
  g.lineWidth = 1.8;
  g.lineJoin = "round";
  g.stroke();
  g.lineTo(width, height);
  g.lineTo(x(0), height);
  g.closePath();
  g.globalAlpha = 0.13;
  g.fillStyle = colours.accent;
  g.fill();
  g.globalAlpha = 1;
}
