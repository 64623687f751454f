// What the small drawings share: the colours of the style sheets, and canvases as sharp as the screen.

const NAMES = ["text", "muted", "line", "accent", "good", "warn", "bad", "surface"];
const scheme = window.matchMedia("(prefers-color-scheme: dark)");
let colours = null;
scheme.addEventListener("change", () => {
  colours = null;
});

/** The colours in force, by name. */
export function palette() {
  if (colours === null) {
    const style = getComputedStyle(document.documentElement);
    colours = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }
  return colours;
}

/** A canvas's context with one unit a CSS pixel, and its size in those. */
export function fitted(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}
