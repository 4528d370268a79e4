// Shared by the canvases: size in device pixels, colours of the theme, size of texts, axes, numbers as text.

const NAMES = [
  ...["paper", "panel", "ink", "quiet", "line", "grid", "board", "lane", "edge", "admissible", "partial", "manifold"],
  ...["angle", "reference", "error", "torque", "inertia", "si", "di", "dead", "stop", "outline", "grey"],
];
export const TEXT = 11; // px, the usual size of texts
// Sizes around axes, px, with texts of the usual size:
const LEFT = 52; // of the labels on the left and their title, at least
const TITLE = 26; // of it for the title, ticks and gaps
const BOTTOM = 34;
const TOP = 10;
const RIGHT = 12;
let found = null;
window.addEventListener("appearancechange", () => {
  found = null;
});

export function colours() {
  if (!found) {
    const style = getComputedStyle(document.documentElement);
    found = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }
  return found;
}

// The size of texts of an element, over the usual one: the layout for presenters has larger ones.
export function unitOf(element) {
  return Number.parseFloat(getComputedStyle(element).fontSize) / TEXT;
}

// A font of the usual size times `unit`.
export function font(unit, weight = 400) {
  return `${weight} ${TEXT * unit}px system-ui, sans-serif`;
}

// Return a cleared surface: its context in CSS pixels, with width, height, unit of texts, and colours.
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
  const unit = unitOf(canvas);
  context.font = font(unit);
  return { context, width, height, unit, colour: colours() };
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

// The space inside the axes, px, with marks on the left; the labels there have at least `left` px of texts of the
// usual size, so that they keep their room while the marks change.
export function framed({ context, width, height, unit }, marks, left) {
  const widest = Math.ceil(Math.max(0, ...marks.map((one) => context.measureText(one).width)));
  const x = Math.max(left * unit, LEFT * unit, TITLE * unit + widest);
  return { x, y: TOP, w: width - x - RIGHT, h: height - TOP - BOTTOM * unit, left: x / unit };
}

// From values within bounds to the screen.
export function mapping({ x, y, w, h }, [left, right, low, high]) {
  return (across, up) => [x + ((across - left) / (right - left)) * w, y + (1 - (up - low) / (high - low)) * h];
}

// About as many marks as have room on an axis of a length, px, each `space` px of the usual size.
export function marked(low, high, length, unit, space = 60) {
  return ticks(low, high, Math.max(2, length / (space * unit)));
}

// Draw axes with titles; `marks` are the labels on the left.
export function axes({ context, colour, unit }, at, { x: begin, y: top, w, h, left: room }, [left, right, low], marks, titles) {
  context.font = font(unit);
  context.lineWidth = 1;
  context.strokeStyle = colour.line;
  context.fillStyle = colour.quiet;
  context.textAlign = "center";
  for (const mark of marked(left, right, w, unit)) {
    const [x, y] = at(mark, low);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x, y + 4);
    context.stroke();
    const text = String(mark);
    context.fillText(text, Math.min(x, begin + w + RIGHT - context.measureText(text).width / 2), y + 4 + TEXT * unit);
  }
  context.textAlign = "right";
  for (const mark of marks) {
    const [x, y] = at(left, mark);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x - 4, y);
    context.stroke();
    context.fillText(String(mark), x - 6, y + 4 * unit);
  }
  context.textAlign = "center";
  context.fillText(titles[0], begin + w / 2, top + h + (BOTTOM - 4) * unit);
  context.save();
  context.font = font(unit * Math.min(1, (top + h) / context.measureText(titles[1]).width));
  context.translate(begin - room * unit + TEXT * unit, top + h / 2);
  context.rotate(-Math.PI / 2);
  context.fillText(titles[1], 0, 0);
  context.restore();
  context.strokeRect(begin, top, w, h);
}
