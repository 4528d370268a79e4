// Shared by the canvases: size in device pixels, colours of the theme, numbers as text.

const NAMES = [
  ...["paper", "panel", "ink", "quiet", "line", "grid", "board", "lane", "edge", "admissible", "partial", "manifold"],
  ...["angle", "reference", "error", "torque", "inertia", "si", "di", "dead", "stop", "outline", "grey"],
];
const FONT = "11px system-ui, sans-serif";
const LEFT = 52; // px of the labels on the left and their title, at least
const TITLE = 26; // px of it for the title, ticks and gaps
const BOTTOM = 34;
const TOP = 10;
const RIGHT = 12;
let found = null;
window.addEventListener("themechange", () => {
  found = null;
});

export function colours() {
  if (!found) {
    const style = getComputedStyle(document.documentElement);
    found = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }
  return found;
}

// Return a context in CSS pixels, cleared, with its width and height.
export function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

// A rounded number; `data` elements also carry the exact one.
export function short(value, digits = 5) {
  if (value === null || value === undefined) {
    return "–";
  }
  if (value === 0) {
    return "0";
  }
  const size = Math.abs(value);
  return size < 1e-4 || size >= 1e6 ? value.toExponential(digits - 2) : value.toPrecision(digits);
}

// Round numbers between two bounds, about `count` of them.
export function ticks(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= raw);
  const found = [];
  for (let index = Math.ceil(low / step - 1e-9); index * step <= high + 1e-9 * step; index += 1) {
    found.push(Number((index * step).toPrecision(12)));
  }
  return found;
}

// The typed number, with a decimal point or comma; null for anything else. A number with both, as 1,000.5, is
// ambiguous.
export function parsed(text) {
  const plain = text.trim().replace("\u2212", "-");
  return /^[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?$/i.test(plain) ? Number(plain.replace(",", ".")) : null;
}

// The colour of an event by its kind.
export function eventColour(kind, colour) {
  return { DEAD: colour.dead, SAFE_STOP: colour.stop, LEFT: colour.grey, STALLED: colour.grey }[kind] ?? colour.ink;
}

// The space inside the axes, px, with marks on the left; the labels have at least `left` px.
export function framed(context, width, height, marks, left) {
  context.font = FONT;
  const x = Math.max(left, LEFT, TITLE + Math.ceil(Math.max(0, ...marks.map((one) => context.measureText(one).width))));
  return { x, y: TOP, w: width - x - RIGHT, h: height - TOP - BOTTOM };
}

// From values within bounds to the screen.
export function mapping({ x, y, w, h }, [left, right, low, high]) {
  return (across, up) => [x + ((across - left) / (right - left)) * w, y + (1 - (up - low) / (high - low)) * h];
}

// Draw axes with titles; `marks` are the labels on the left.
export function axes(context, colour, at, { x: begin, y: top, w, h }, [left, right, low], marks, titles) {
  context.font = FONT;
  context.lineWidth = 1;
  context.strokeStyle = colour.line;
  context.fillStyle = colour.quiet;
  context.textAlign = "center";
  for (const mark of ticks(left, right, Math.max(2, w / 60))) {
    const [x, y] = at(mark, low);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x, y + 4);
    context.stroke();
    const text = String(mark);
    context.fillText(text, Math.min(x, begin + w + RIGHT - context.measureText(text).width / 2), y + 15);
  }
  context.textAlign = "right";
  for (const mark of marks) {
    const [x, y] = at(left, mark);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x - 4, y);
    context.stroke();
    context.fillText(String(mark), x - 6, y + 4);
  }
  context.textAlign = "center";
  context.fillText(titles[0], begin + w / 2, top + h + BOTTOM - 4);
  context.save();
  context.translate(11, top + h / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(titles[1], 0, 0);
  context.restore();
  context.strokeRect(begin, top, w, h);
}
