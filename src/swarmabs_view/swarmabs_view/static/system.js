// The scene of a parent system without a picture of its own: robots along a line or in a plan view, with its outline.
import { capital, roles, titled } from "./description.js";
import { axes, framed, mapping, marked, short } from "./drawing.js";
import { drawRobots } from "./robots.js";

const SPACE = 0.08; // around what is drawn, of its size
const LOOSEST = 3; // size of the part shown, over that of what is drawn, from which on the scale follows
const NARROWEST = 0.45; // width of the axes, over the space for them
const SMALLEST = 7; // px, radius of a body, at least

// The range shown of an axis: it changes only when something is outside, or everything has become much smaller.
function kept(held, values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const size = Math.max(high - low, 0.01);
  if (held && held[0] <= low && high <= held[1] && held[1] - held[0] <= LOOSEST * size) {
    return held;
  }
  return [low - SPACE * size, high + SPACE * size];
}

// Make a box as narrow as bounds with equal scales on both axes allow.
function narrowed(box, [left, right, low, high]) {
  const w = Math.min(Math.max((box.h * (right - left)) / (high - low), NARROWEST * box.w), box.w);
  return { ...box, x: box.x + (box.w - w) / 2, w };
}

// Extend bounds to equal scales on both axes of a box.
function square([left, right, low, high], { w, h }) {
  const size = Math.max((right - left) / w, (high - low) / h); // of a px
  const [x, y] = [(left + right) / 2, (low + high) / 2];
  return [x - (size * w) / 2, x + (size * w) / 2, y - (size * h) / 2, y + (size * h) / 2];
}

export class SystemScene {
  whole = "picture"; // what the picture shows
  crowds = false; // whether many robots are shown by their density
  lever = false; // whether a push acts by the distance from an axis
  legend = ["limited"]; // entries that only some pictures have

  hello() {
    this.across = this.up = null;
    this.left = 0;
  }

  draw(surface, hello, frame, { fit, ids }) {
    const { context, height, unit } = surface;
    const { position } = frame.robots;
    const bodies = hello.robots.map(({ body }) => body);
    const robots = position.flatMap((place, index) => (place ? around(place, bodies[index]) : []));
    const lanes = !frame.outline.length && robots.every((place) => place.length < 2);
    const points = fit && robots.length ? robots : [[0, 0], ...frame.outline.flat(), ...robots];
    this.across = kept(this.across, points.map(([x]) => x));
    this.up = lanes ? [0, 1] : kept(this.up, points.map(([, y]) => y ?? 0));
    const bounds = [...this.across, ...this.up];
    // The labels on the left depend on the part shown, and the part shown on the room that they leave.
    let [box, shown, marks] = [null, bounds, []];
    for (let pass = 0; pass < 2; pass += 1) {
      box = framed(surface, marks, this.left);
      this.left = box.left;
      box = lanes ? box : narrowed(box, bounds);
      shown = lanes ? bounds : square(bounds, box);
      marks = lanes ? [] : marked(shown[2], shown[3], height, unit);
    }
    const place = mapping(box, shown);
    const at = lanes ? ([x], index) => place(x, 1 - (index + 0.5) / hello.robots.length) : ([x, y]) => place(x, y ?? 0);
    const titles = hello.system.placed ? ["x, m", "y, m"] : roles(hello.system).robot.map(titled);
    this.outline(surface, frame.outline, place, box);
    axes(surface, place, box, shown, marks, [titles[0], lanes ? "" : (titles[1] ?? "")]);
    if (fit && frame.outline.flat().some(([x, y]) => x < shown[0] || x > shown[1] || y < shown[2] || y > shown[3])) {
      context.textAlign = "left";
      context.fillText("section around the robots", box.x + 6, box.y + 14 * unit);
    }
    const scale = box.w / (shown[1] - shown[0]);
    const bodyOf = (where, index) => body(bodies[index], where, place, scale, unit);
    return drawRobots(surface, hello, frame, { at, bodyOf, lane: box.h / (lanes ? hello.robots.length : fit ? 8 : 16), ids });
  }

  // The lines of the system, within the axes; closed ones are filled.
  outline({ context, colour, unit }, lines, place, box) {
    context.save();
    context.beginPath();
    context.rect(box.x, box.y, box.w, box.h);
    context.clip();
    context.fillStyle = colour.board;
    context.strokeStyle = colour.edge;
    context.lineWidth = 2 * unit;
    for (const line of lines) {
      context.beginPath();
      line.forEach((one) => context.lineTo(...place(...one)));
      if (line[0].every((value, axis) => value === line.at(-1)[axis])) {
        context.fill();
      }
      context.stroke();
    }
    context.restore();
  }

  describe(hello, frame) {
    return `${capital(hello.system.name)} at ${short(frame.time, 4)} s`;
  }
}

// The distance of the farthest point of a body from its place.
const radius = (lines) => Math.max(0, ...(lines ?? []).flat().map((point) => Math.hypot(...point)));

// A place, or corners around the body that is there.
function around(place, lines) {
  const far = radius(lines);
  const [x, y = 0] = place;
  return far ? [[x - far, y - far], [x + far, y + far]] : [place];
}

// The lines of a body at a place, turned if the place has an angle; px. None for a robot with the symbol of its kind.
function body(lines, [x, y = 0, angle = 0], place, scale, unit) {
  if (!lines?.length) {
    return null;
  }
  const larger = Math.max(1, (SMALLEST * unit) / (scale * (radius(lines) || 1)));
  const [c, s] = [larger * Math.cos(angle), larger * Math.sin(angle)];
  return lines.map((line) => line.map(([dx, dy]) => place(x + c * dx - s * dy, y + s * dx + c * dy)));
}
